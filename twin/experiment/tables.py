"""The tables of an experiment's file, each of them checked by itself."""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from twin.errors import InputRefused
from twin.experiment import schema
from twin.experiment.body_files import fill_from_body
from twin.experiment.change import Change, checked_changes
from twin.experiment.drive_files import joint_tables
from twin.experiment.experiment import ARRAYS, OPTIONAL_TABLES, TABLES, Experiment, Head
from twin.experiment.fault import Fault, checked_faults
from twin.experiment.inheritance import fill_from_robot
from twin.experiment.measure import Measure, checked_measures
from twin.experiment.mistakes import keys, sentences, unknown
from twin.experiment.quantity import Section
from twin.experiment.reference import WayPoints
from twin.experiment.source import Source
from twin.experiment.task import Task, checked_tasks
from twin.experiment.ticks import MOST_TICKS

OTHERS = ("drive", *ARRAYS)
"""What is checked elsewhere than `TABLES`."""


@dataclass(frozen=True)
class Tables:
    """What of an experiment's file is right by itself, SI.

    Attributes:
        by_name: the tables; "head": the keys that stand in none.
        duration: of the experiment (s); inf if the file does not rightly say.
        tasks: by their numbers. ticks: durations and periods by name.
        faults, changes, measures, drives: as in `Experiment`.
    """

    by_name: dict[str, Any]
    duration: float
    tasks: dict[int, Task]
    ticks: dict[str, int]
    faults: tuple[Fault, ...]
    changes: tuple[Change, ...]
    measures: tuple[Measure, ...]
    drives: list[schema.Drive]


def checked_tables(source: Source, folder: Path, mistakes: list[str]) -> Tables:
    """The tables of `source`, which is completed in place.

    Args:
        source: of all files. folder: from which bodies and drives are looked up.
        mistakes: gets a sentence for each mistake.
    """
    fill_from_robot(source.values)
    values = source.values
    try:
        fill_from_body(source, folder)
    except InputRefused as problem:
        mistakes.append(str(problem))
        # all that the body would have said is missing now, and that is no second mistake
        values = {**values, "contact": None}
    checked = _checked(values, mistakes)
    tasks = checked_tasks(source.values.get("task"), mistakes)
    drives = _joint_drives(source.values.get("drive"), folder, mistakes)
    ticks = _ticks(checked, mistakes)
    # without a tick there are no ticks to count a fault's onset in
    tick = checked["cosim"].tick if "cosim" in checked else 1e-9
    faults = checked_faults(source.values.get("fault", ()), tick, mistakes)
    length = checked["head"].duration if "head" in checked else math.inf
    changes = checked_changes(source.values.get("change", ()), source.values, tick, length, mistakes)
    measures = checked_measures(source.values.get("measure", ()), length, mistakes)
    return Tables(checked, length, tasks, ticks, faults, changes, measures, drives)


def experiment_of(name: str, tables: Tables, reference: WayPoints | None, source: Source) -> Experiment:
    """The experiment that `tables`, of which none is missing, make.

    Args:
        name: of the experiment. reference: its [reference] as way points. source: that of the tables.
    """
    checked, ticks, (one, two, three) = tables.by_name, tables.ticks, tables.drives
    head, monitor = checked["head"], checked.get("monitor")
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
        reference=reference,
        approach=checked.get("approach"),
        tasks=tuple(tables.tasks.values()),
        monitor=monitor if monitor is not None and monitor.enabled else None,
        faults=tables.faults,
        changes=tables.changes,
        measures=tables.measures,
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
