"""Experiments: checked tables, derived quantities, and variants with one change; all in SI.

Authors change keys of the file; the classes and functions here change checked values, for studies of the twin itself.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.kernel.errors import InputRefused
from twin.kernel.settings import Settings, Triple, setting
from twin.robot.experiment import schema
from twin.robot.experiment.drive_files import joint_tables
from twin.robot.experiment.experiment_files import fill_from_body
from twin.robot.experiment.fault import Fault, checked_faults
from twin.robot.experiment.measure import Measure, checked_measures
from twin.robot.experiment.mistakes import check_table, toml_keys, unknown_key
from twin.robot.experiment.schema import (
    MAX_TICKS,
    Change,
    DeclaredTables,
    Reference,
    WayPoints,
    checked_changes,
    checked_tasks,
    whole_ticks,
)
from twin.robot.experiment.source import RETAINED_KEYS, Source, with_numbers
from twin.robot.experiment.stand_in import StandIn, check_third_party_table, find_stand_in_table

if TYPE_CHECKING:
    # the tables of the parts, imported for the type checker only
    from twin.robot.controller.program import Approach, Task
    from twin.robot.controller.task_controller import Computer
    from twin.robot.monitor.limits import Monitor
    from twin.robot.plant.contact_law import Contact
    from twin.robot.plant.dynamics import Robot, TrueRobot
    from twin.robot.plant.encoder import Display

NEEDED_TABLES: dict[str, type[Settings]] = {"cosim": schema.Cosim}
OPTIONAL_TABLES: dict[str, type[Settings]] = {
    "reference": Reference,
    "recording": schema.RecordingSettings,
    "estimator": StandIn,
    "body": StandIn,
}
"""Optional tables that belong to no part."""
TABLE_ARRAYS = ("task", "fault", "change", "measure")
SEPARATE_TABLES = ("drive", *TABLE_ARRAYS)
"""Tables that are checked separately from the declared ones."""
EXACT_COUNTS = 2**40
"""Counts per turn of a practically exact encoder: a count is 6e-12 rad."""


class TopLevelKeys(Settings):
    """The keys of an experiment outside any table."""

    title: str = setting(min_length=1, help="title for reports and pictures")
    duration: float = setting("s", gt=0, help="simulated time; a whole number of ticks")
    seed: int = setting(default=0, ge=0, lt=2**63, help="seed of the encoders' noise; same seed, same bytes")


@dataclass(frozen=True)
class Experiment:
    """A checked experiment with all data that a run needs, SI.

    The tables are declared by the parts, by `schema.py` and by `program.py`.

    Attributes:
        name: stem of the file name.
        seed: seed of the encoders' noise.
        duration_ticks, controller_ticks, scale_ticks, monitor_ticks: durations and periods in ticks.
        reference: waypoints, also of a shape; None if `tasks` lead the robot, with motions by `approach`.
        scale, monitor: None without a display, or an enabled safety monitor.
        measures: measures of `twin check`.
        drives: one per joint, complete, FMUs as absolute paths.
        values, origins: merged and checked file, keys with units; origin of each value.
        stand_ins: third-party parts by table name; only their retained keys stay in [controller], [monitor] and
            [scale].
        remarks: remarks on values that a run reports, as in `Source`.
        typed: arguments of `twin run` that load it; empty if it was not loaded from a file.
    """

    name: str
    title: str
    seed: int
    duration_ticks: int
    controller_ticks: int
    scale_ticks: int
    monitor_ticks: int
    robot: Robot
    plant: TrueRobot
    contact: Contact
    scale: Display | None
    cosim: schema.Cosim
    controller: Computer
    reference: WayPoints | None
    approach: Approach | None
    tasks: tuple[Task, ...]
    monitor: Monitor | None
    faults: tuple[Fault, ...]
    changes: tuple[Change, ...]
    measures: tuple[Measure, ...]
    drives: tuple[schema.Drive, schema.Drive, schema.Drive]
    recording: schema.RecordingSettings
    values: dict[str, Any]
    origins: dict[str, str]
    stand_ins: dict[str, StandIn] = field(default_factory=dict)
    remarks: tuple[str, ...] = field(default=(), compare=False)
    typed: tuple[str, ...] = field(default=(), compare=False)

    @property
    def start(self) -> Triple:
        """Platform position (m) at which the experiment starts, at rest."""
        if self.reference is not None:
            return self.reference.p[0]
        assert self.approach is not None
        return (*self.tasks[0].point, self.approach.height)


@dataclass(frozen=True)
class Tables:
    """The valid tables of an experiment's file, SI, before the experiment is built.

    Attributes:
        by_name: tables; "head" has the keys outside any table.
        duration: duration of the experiment (s); inf if missing or invalid.
        tasks: tasks by number.
        ticks: durations and periods by name.
    """

    by_name: dict[str, Any]
    duration: float
    tasks: dict[int, Task]
    ticks: dict[str, int]
    faults: tuple[Fault, ...]
    changes: tuple[Change, ...]
    measures: tuple[Measure, ...]
    drives: list[schema.Drive]
    stand_ins: dict[str, StandIn]


def checked_tables(declared: DeclaredTables, source: Source, folder: Path, mistakes: list[str]) -> Tables:
    """Check the tables of an experiment's file and complete its values in place.

    Bodies and drives are looked up in `folder`.
    """
    _fill_from_robot(declared, source.values)
    values = source.values
    try:
        fill_from_body(source, folder)
    except InputRefused as problem:
        mistakes.append(str(problem))
        # values missing without the body are not reported as further errors
        values = {**values, "contact": None}
    by_name, stand_ins = _check_tables(declared, values, folder, mistakes)
    tasks = checked_tasks(declared.tasks, source.values.get("task"), mistakes)
    drives = _joint_drives(source.values.get("drive"), folder, mistakes)
    ticks = _ticks(by_name, mistakes)
    # without a tick, the onset of a fault cannot be counted in ticks
    tick = by_name["cosim"].tick if "cosim" in by_name else 1e-9
    faults = checked_faults(source.values.get("fault", ()), tick, mistakes)
    length = by_name["head"].duration if "head" in by_name else math.inf
    changes = checked_changes(declared, source.values.get("change", ()), source.values, tick, length, mistakes)
    measures = checked_measures(source.values.get("measure", ()), length, mistakes)
    return Tables(by_name, length, tasks, ticks, faults, changes, measures, drives, stand_ins)


def experiment_of(name: str, tables: Tables, reference: WayPoints | None, source: Source) -> Experiment:
    """Build the experiment from its complete tables and waypoints."""
    found, ticks, (one, two, three) = tables.by_name, tables.ticks, tables.drives
    head, monitor = found["head"], found.get("monitor")
    return Experiment(
        name=name,
        title=head.title,
        seed=head.seed,
        duration_ticks=ticks["duration"],
        controller_ticks=ticks["controller"],
        scale_ticks=ticks.get("scale", 1),
        monitor_ticks=ticks.get("monitor", 1),
        **{name: found[name] for name in ("robot", "plant", "contact", "cosim", "controller")},
        scale=found.get("scale"),
        reference=reference,
        approach=found.get("approach"),
        tasks=tuple(tables.tasks.values()),
        monitor=monitor if monitor is not None and monitor.enabled else None,
        faults=tables.faults,
        changes=tables.changes,
        measures=tables.measures,
        drives=(one, two, three),
        recording=found.get("recording", schema.RecordingSettings()),
        values=source.values,
        origins=source.origins,
        stand_ins=tables.stand_ins,
        remarks=tuple(source.remarks),
    )


def _fill_from_robot(declared: DeclaredTables, values: dict[str, Any]) -> None:
    """Fill missing values of [plant] and [controller.model] with those from [robot], in place."""
    robot = values.get("robot")
    if not isinstance(robot, dict):
        return
    fields = declared.tables["robot"].model_fields.values()
    whole = {str(field.alias): field.default for field in fields if isinstance(field.default, tuple)} | robot
    plant, controller = values.setdefault("plant", {}), values.setdefault("controller", {})
    if isinstance(plant, dict):
        values["plant"] = {**robot, **_with_numbered_values(whole, plant, "plant")}
    if isinstance(controller, dict):
        model = controller.get("model", {})
        if isinstance(model, dict):
            known = declared.model_keys()
            believed = {k: v for k, v in robot.items() if k in known}
            controller["model"] = {**believed, **_with_numbered_values(whole, model, "controller.model")}


def _with_numbered_values(known: dict[str, Any], own: dict[str, Any], table: str) -> dict[str, Any]:
    """Return a table with values of single elements, such as `joint_zero_deg.2`, merged into whole vectors."""
    numbered = {
        key: with_numbers(value, known[key], f"{table}.{key}")
        for key, value in own.items()
        if isinstance(value, dict) and isinstance(known.get(key), tuple)
    }
    return {**own, **numbered}


def _check_tables(
    declared: DeclaredTables, values: dict[str, Any], folder: Path, mistakes: list[str]
) -> tuple[dict[str, Any], dict[str, StandIn]]:
    """Check all tables of an experiment; return valid ones and third-party parts, append errors to `mistakes`."""
    right: dict[str, Any] = {}
    stand_ins: dict[str, StandIn] = {}
    known = declared.tables
    head = {key: value for key, value in values.items() if key not in known and key not in SEPARATE_TABLES}
    for key in list(head):
        if key not in toml_keys(TopLevelKeys):
            mistakes.append(unknown_key(key, [*toml_keys(TopLevelKeys), *known, *SEPARATE_TABLES]))
            del head[key]
    models: dict[str, type[Settings]] = {"head": TopLevelKeys, **known}
    for name, model in models.items():
        table = head if name == "head" else values.get(name)
        if table is None:
            if name in declared.needed and name not in values:
                mistakes.append(f"missing table [{name}]")
            continue
        found: list[str] = []
        if name in RETAINED_KEYS and (table_of_other := find_stand_in_table(values, name)) is not None:
            stand_in, section = check_third_party_table(declared, name, table_of_other, folder, found)
            if stand_in is not None:
                stand_ins[name] = stand_in
            if section is not None:
                right[name] = section
        elif (section := check_table(model, table, name, found)) is not None:
            right[name] = section
        # an error in [robot] is reported once, not again for each table filled from it
        reported = {mistake.partition("] ")[2] for mistake in mistakes if mistake.startswith("[robot]")}
        found = [sentence.replace("[head] ", "") for sentence in found]
        mistakes += [sentence for sentence in found if sentence.partition("] ")[2] not in reported]
    if "monitor" in right and not right["monitor"].enabled:
        stand_ins.pop("monitor", None)
    return right, stand_ins


def _ticks(tables: dict[str, Any], mistakes: list[str]) -> dict[str, int]:
    """Convert durations and periods of the experiment to whole ticks, by name."""
    wanted = {
        "duration": ("head", "duration", "duration_s"),
        "controller": ("controller", "period", "[controller] period_ms"),
        "scale": ("scale", "period", "[scale] period_ms"),
        "monitor": ("monitor", "period", "[monitor] period_ms"),
        "latency": ("plant", "encoder_latency", "[plant] encoder_latency_ms"),
    }
    if "cosim" not in tables:
        return {}
    tick = tables["cosim"].tick
    ticks = {}
    for name, (table, attribute, key) in wanted.items():
        if table in tables:
            length = getattr(tables[table], attribute)
            if length == 0.0:
                # no latency; for all others 0 has been refused already
                continue
            ticks[name] = whole_ticks(length, tick) or 0
            if length / tick > MAX_TICKS:
                mistakes.append(f"{key}: {length:g} s are more than {MAX_TICKS:g} ticks of {tick:g} s; expected fewer")
            elif not ticks[name]:
                mistakes.append(f"{key}: {length:g} s is not a whole number of ticks of {tick:g} s")
    return ticks


def _joint_drives(drive: Any, folder: Path, mistakes: list[str]) -> list[schema.Drive]:
    """Check the complete drive tables of the three joints; an error common to all is reported once."""
    if not isinstance(drive, dict):
        mistakes.append("missing table [drive]" if drive is None else f"[drive] = {drive!r}: expected a table")
        return []
    try:
        tables = joint_tables(drive, folder)
    except InputRefused as problem:
        mistakes.append(f"[drive] {problem}")
        return []
    found: list[str] = []
    drives = [check_table(schema.Drive, table, "drive", found) for table in tables]
    mistakes += [mistake for mistake in dict.fromkeys(found) if mistake not in mistakes]
    return [drive for drive in drives if drive is not None]


def with_plant(experiment: Experiment, **values: Any) -> Experiment:
    """Return a copy of the experiment with other true values of the robot, [plant]."""
    return replace(experiment, plant=experiment.plant.model_copy(update=values))


def with_model(experiment: Experiment, **values: Any) -> Experiment:
    """Return a copy of the experiment with another robot model of the controller, [controller.model]."""
    computer = experiment.controller
    model = computer.model.model_copy(update=values)
    return replace(experiment, controller=computer.model_copy(update={"model": model}))


def with_cosim(experiment: Experiment, **values: Any) -> Experiment:
    """Return a copy of the experiment with another tick (s), coupling scheme, input mode or iteration count.

    Durations in seconds stay. The experiment has no faults, whose onsets are counted in ticks, too.
    """
    cosim = experiment.cosim.model_copy(update=values)

    def recounted(name: str, ticks: int) -> int:
        length = ticks * experiment.cosim.tick
        count = whole_ticks(length, cosim.tick)
        if not count:
            problem = f"{name} of {length:g} s is not a whole number of ticks of {cosim.tick:g} s"
            raise InputRefused(f"{experiment.name}: {problem}")
        return count

    optional = [name for name in ("scale", "monitor") if getattr(experiment, name) is not None]
    counts: dict[str, Any] = {
        f"{name}_ticks": recounted(name, getattr(experiment, f"{name}_ticks"))
        for name in ("duration", "controller", *optional)
    }
    changes = tuple(replace(change, tick=recounted("time of a change", change.tick)) for change in experiment.changes)
    delays = {
        key: recounted(name, ticks)
        for key, name in (("delay_ticks", "delay"), ("bus_delay_ticks", "delay of the bus"))
        if (ticks := getattr(experiment.controller, key))
    }
    if experiment.plant.encoder_latency:
        recounted("latency of the encoders", whole_ticks(experiment.plant.encoder_latency, experiment.cosim.tick) or 0)
    computer = experiment.controller.model_copy(update=delays)
    return replace(experiment, cosim=cosim, controller=computer, changes=changes, **counts)


def with_exact_encoders(experiment: Experiment) -> Experiment:
    """Return a copy of the experiment whose encoders have no rounding and noise, also as the controller sees them."""
    counts = {"motor_counts_per_turn": EXACT_COUNTS, "joint_counts_per_turn": EXACT_COUNTS}
    return with_model(with_plant(experiment, motor_noise=0.0, joint_noise=0.0, **counts), **counts)


def shorten(experiment: Experiment, duration: float) -> Experiment:
    """Return a copy of the experiment that ends after `duration` seconds, in whole periods of the controller."""
    period = experiment.controller_ticks
    ticks = max(1, round(duration / (period * experiment.cosim.tick))) * period
    return replace(experiment, duration_ticks=min(ticks, experiment.duration_ticks))
