"""The validated experiment, SI inside, and how a file becomes one."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from twin.errors import InputRefused, Unreachable
from twin.experiment import schema, task
from twin.experiment.agreement import disagreements
from twin.experiment.body_files import fill_from_body, replace_body
from twin.experiment.change import Change, checked_changes
from twin.experiment.contact import Contact
from twin.experiment.drive_files import joint_tables, shelved
from twin.experiment.fault import checked_faults
from twin.experiment.inheritance import fill_from_robot
from twin.experiment.measure import Measure, checked_measures
from twin.experiment.mistakes import keys, sentences, unknown
from twin.experiment.monitor import Monitor
from twin.experiment.named import experiment_file
from twin.experiment.quantity import Section, quantity
from twin.experiment.reach import geometry_of
from twin.experiment.reference import Reference, WayPoints, way_points
from twin.experiment.source import Source, override, read_source, replace_drive
from twin.experiment.ticks import MOST_TICKS
from twin.experiment.unit_hints import unit_hints
from twin.faults.fault import Fault


class Head(Section):
    """The keys of an experiment that stand in no table."""

    title: str = Field(min_length=1, description="for people")
    duration: float = quantity("duration_s", gt=0, description="simulated time")
    seed: int = Field(0, ge=0, lt=2**63, description="seed of the encoders' noise")


TABLES: dict[str, type[Section]] = {
    "robot": schema.Robot,
    "plant": schema.Plant,
    "contact": Contact,
    "cosim": schema.Cosim,
    "controller": schema.Controller,
}
OPTIONAL_TABLES: dict[str, type[Section]] = {
    "scale": schema.Scale,
    "reference": Reference,
    "approach": task.Approach,
    "monitor": Monitor,
    "recording": schema.Recording,
}
ARRAYS = ("task", "fault", "change", "measure")
"""Arrays of tables."""
OUT_OF_REACH = "out of reach"
"""What every sentence on a pose has in it where the robot cannot be."""
OTHERS = ("drive", *ARRAYS)
"""What is checked elsewhere than `TABLES`."""


@dataclass(frozen=True)
class Experiment:
    """Everything a run needs, checked, SI.

    Attributes:
        name: the file's stem. title: for people. seed: of the encoders' noise.
        duration_ticks, controller_ticks, scale_ticks, monitor_ticks: durations and periods in ticks.
        reference: way points, those of a shape too; None: `tasks` lead the robot, and `approach` says how they come
            and go.
        scale: the display; None: what the robot presses on has none.
        monitor: None: nobody watches.
        faults: what breaks, in ticks.
        changes: what of the controller changes on the way, in ticks. measures: what `twin check` measures.
        drives: one per joint, complete, FMUs as absolute paths.
        recording: what of the run is kept.
        values: the merged file as it was checked, keys with units. origins: where each value comes from.
    The tables are those of `schema.py`, `contact.py`, `task.py` and `monitor.py`.
    """

    name: str
    title: str
    seed: int
    duration_ticks: int
    controller_ticks: int
    scale_ticks: int
    monitor_ticks: int
    robot: schema.Robot
    plant: schema.Plant
    contact: Contact
    scale: schema.Scale | None
    cosim: schema.Cosim
    controller: schema.Controller
    reference: WayPoints | None
    approach: task.Approach | None
    tasks: tuple[task.Task, ...]
    monitor: Monitor | None
    faults: tuple[Fault, ...]
    changes: tuple[Change, ...]
    measures: tuple[Measure, ...]
    drives: tuple[schema.Drive, schema.Drive, schema.Drive]
    recording: schema.Recording
    values: dict[str, Any]
    origins: dict[str, str]

    @property
    def start(self) -> schema.Triple:
        """Where the platform rests at the beginning (m)."""
        if self.reference is not None:
            return self.reference.p[0]
        assert self.approach is not None
        return (*self.tasks[0].point, self.approach.height)


def load_experiment(
    path: str | Path, overrides: Iterable[str] = (), drive: str | None = None, body: str | None = None
) -> Experiment:
    """Read, merge and check the experiment at `path`.

    Args:
        path: a TOML file, or the name of an experiment, see `experiment_file`.
        overrides: "table.key=value" texts laid over it; of an array of tables "task.1.force_N=4".
        drive: an FMU or a drive of fmus/ that replaces the drive of every joint and its parameters.
        body: a file of bodies/ that replaces all of [contact] but its height.

    Raises:
        InputRefused: with every mistake, one sentence each.
    """
    path = experiment_file(path)
    source = read_source(path)
    folder = path.resolve().parent
    if drive is not None:
        replace_drive(source, shelved(drive, folder))
    if body is not None:
        replace_body(source, body)
    override(source, overrides)
    return checked_experiment(source, path.stem, path, folder)


def checked_experiment(source: Source, name: str, where: Path, folder: Path) -> Experiment:
    """The experiment that `source` says, which is completed in place.

    Args:
        source: of all files. name: of the experiment. where: it comes from, for sentences.
        folder: from which bodies and drives are looked up.

    Raises:
        InputRefused: with every mistake, one sentence each.
    """
    fill_from_robot(source.values)
    mistakes: list[str] = []
    values = source.values
    try:
        fill_from_body(source, folder)
    except InputRefused as problem:
        mistakes.append(str(problem))
        # all that the body would have said is missing now, and that is no second mistake
        values = {**values, "contact": None}
    checked = _checked(values, mistakes)
    tasks = task.checked_tasks(source.values.get("task"), mistakes)
    drives = _joint_drives(source.values.get("drive"), folder, mistakes)
    ticks = _ticks(checked, mistakes)
    # without a tick there are no ticks to count a fault's onset in
    tick = checked["cosim"].tick if "cosim" in checked else 1e-9
    faults = checked_faults(source.values.get("fault", ()), tick, mistakes)
    length = checked["head"].duration if "head" in checked else math.inf
    changes = checked_changes(source.values.get("change", ()), source.values, tick, length, mistakes)
    measures = checked_measures(source.values.get("measure", ()), length, mistakes)
    _expand_reference(checked, length, mistakes)
    apart = disagreements(checked, tasks, source.values)
    if any(OUT_OF_REACH in mistake for mistake in apart):
        mistakes += unit_hints(source.values)
    mistakes += apart
    if mistakes:
        raise InputRefused(_told(where, mistakes))
    head, (one, two, three) = checked["head"], drives
    monitor = checked.get("monitor")
    return Experiment(
        name=name,
        title=head.title,
        seed=head.seed,
        duration_ticks=ticks["duration"],
        controller_ticks=ticks["controller"],
        scale_ticks=ticks.get("scale", 1),
        monitor_ticks=ticks.get("monitor", 1),
        robot=checked["robot"],
        plant=checked["plant"],
        contact=checked["contact"],
        scale=checked.get("scale"),
        cosim=checked["cosim"],
        controller=checked["controller"],
        reference=checked.get("reference"),
        approach=checked.get("approach"),
        tasks=tuple(tasks.values()),
        monitor=monitor if monitor is not None and monitor.enabled else None,
        faults=faults,
        changes=changes,
        measures=measures,
        drives=(one, two, three),
        recording=checked.get("recording", schema.Recording()),
        values=source.values,
        origins=source.origins,
    )


def _checked(values: dict[str, Any], mistakes: list[str]) -> dict[str, Any]:
    """The tables that are right, by name; what is wrong with the others goes to `mistakes`."""
    checked: dict[str, Any] = {}
    known = {**TABLES, **OPTIONAL_TABLES}
    head = {key: value for key, value in values.items() if key not in known and key not in OTHERS}
    for key in list(head):
        if key not in keys(Head):
            mistakes.append(unknown(key, [*keys(Head), *known, *OTHERS]))
            del head[key]
    models: dict[str, type[Section]] = {"head": Head, **known}
    for name, model in models.items():
        table = head if name == "head" else values.get(name)
        if table is None:
            if name in TABLES and name not in values:
                mistakes.append(f"missing table [{name}]")
            continue
        try:
            checked[name] = model.model_validate(table)
        except ValidationError as error:
            found = [sentence.replace("[head] ", "") for sentence in sentences(error, model, name)]
            # a mistake in [robot] is told once, not again for each table that is filled from it
            told = {mistake.partition("] ")[2] for mistake in mistakes if mistake.startswith("[robot]")}
            mistakes += [sentence for sentence in found if sentence.partition("] ")[2] not in told]
    return checked


def _expand_reference(checked: dict[str, Any], duration: float, mistakes: list[str]) -> None:
    """Put the way points of [reference] in its place."""
    reference, computer = checked.pop("reference", None), checked.get("controller")
    if reference is None:
        return
    try:
        if reference.t is not None:
            checked["reference"] = WayPoints(reference.t, reference.p)
        # a shape has to know whose samples and joints it is made of
        elif computer is not None:
            checked["reference"] = way_points(reference, geometry_of(computer.model), computer.period, duration)
    except Unreachable as problem:
        mistakes.append(f"[reference.joint_step] {problem}")
    except ValueError as problem:
        mistakes.append(str(problem))


def _ticks(checked: dict[str, Any], mistakes: list[str]) -> dict[str, int]:
    """Durations and periods as whole ticks."""
    wanted = {
        "duration": ("head", "duration", "duration_s"),
        "controller": ("controller", "period", "[controller] period_ms"),
        "scale": ("scale", "period", "[scale] period_ms"),
        "monitor": ("monitor", "period", "[monitor] period_ms"),
    }
    if "cosim" not in checked:
        return {}
    tick = checked["cosim"].tick
    ticks = {}
    for name, (table, attribute, key) in wanted.items():
        if table in checked:
            length = getattr(checked[table], attribute)
            if length / tick > MOST_TICKS:
                mistakes.append(f"{key}: {length:g} s are more than {MOST_TICKS:g} ticks of {tick:g} s; expected fewer")
                continue
            ticks[name] = round(length / tick)
            if ticks[name] < 1 or abs(ticks[name] * tick - length) > 1e-9 * length:
                mistakes.append(f"{key}: {length:g} s is not a whole number of ticks of {tick:g} s")
    return ticks


def _joint_drives(drive: Any, folder: Path, mistakes: list[str]) -> list[schema.Drive]:
    """The three joints' complete drives; a mistake they share is told once."""
    if not isinstance(drive, dict):
        mistakes.append("missing table [drive]" if drive is None else f"[drive] = {drive!r}: expected a table")
        return []
    try:
        tables = joint_tables(drive, folder)
    except InputRefused as problem:
        mistakes.append(f"[drive] {problem}")
        return []
    drives = []
    for table in tables:
        try:
            drives.append(schema.Drive.model_validate(table))
        except ValidationError as error:
            mistakes += [told for told in sentences(error, schema.Drive, "drive") if told not in mistakes]
    return drives


def _told(path: Path, mistakes: list[str]) -> str:
    if len(mistakes) == 1:
        return f"{path}: {mistakes[0]}"
    return f"{path} has {len(mistakes)} mistakes:" + "".join(f"\n  {mistake}" for mistake in mistakes)
