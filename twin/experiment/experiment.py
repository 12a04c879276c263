"""The validated experiment, SI inside, and how a file becomes one."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, ValidationError

from twin.errors import InputRefused, Unreachable
from twin.experiment import schema
from twin.experiment.drive_files import joint_tables, shelved
from twin.experiment.mistakes import keys, sentences, unknown
from twin.experiment.quantity import Section, quantity
from twin.experiment.source import override, read_source, replace_drive
from twin.robot.geometry import Geometry
from twin.robot.inverse_kinematics import joint_angles

WAY_POINT_SPACING = 1e-3
"""How densely (m) the straight lines between way points are checked for reach."""


class Head(Section):
    """The keys of an experiment that stand in no table."""

    title: str = Field(min_length=1)
    duration: float = quantity("duration_s", gt=0)


TABLES: dict[str, type[Section]] = {
    "robot": schema.Robot,
    "plant": schema.Plant,
    "contact": schema.Contact,
    "scale": schema.Scale,
    "cosim": schema.Cosim,
    "controller": schema.Controller,
    "reference": schema.Reference,
}


@dataclass(frozen=True)
class Experiment:
    """Everything a run needs, checked, SI.

    Attributes:
        name: the file's stem. title: for people.
        duration_ticks, controller_ticks, scale_ticks: durations and periods in ticks.
        drives: one per joint, complete, FMUs as absolute paths.
        values: the merged file as it was checked, keys with units. origins: where each value comes from.
    The tables are those of `schema.py`.
    """

    name: str
    title: str
    duration_ticks: int
    controller_ticks: int
    scale_ticks: int
    plant: schema.Plant
    contact: schema.Contact
    scale: schema.Scale
    cosim: schema.Cosim
    controller: schema.Controller
    reference: schema.Reference
    drives: tuple[schema.Drive, schema.Drive, schema.Drive]
    values: dict[str, Any]
    origins: dict[str, str]


def load_experiment(path: Path, overrides: Iterable[str] = (), drive: str | None = None) -> Experiment:
    """Read, merge and check the experiment at `path`.

    Args:
        path: a TOML file.
        overrides: "table.key=value" texts laid over it.
        drive: an FMU or a drive of fmus/ that replaces the drive of every joint and its parameters.

    Raises:
        InputRefused: with every mistake, one sentence each.
    """
    source = read_source(path)
    if drive is not None:
        replace_drive(source, shelved(drive, path.resolve().parent))
    override(source, overrides)
    _fill_from_robot(source.values)
    checked, mistakes = _checked(source.values)
    drives = _joint_drives(source.values.get("drive"), path.resolve().parent, mistakes)
    ticks = _ticks(checked, mistakes)
    _refuse_unreachable(checked, mistakes)
    if mistakes:
        raise InputRefused(_told(path, mistakes))
    head, (one, two, three) = checked["head"], drives
    return Experiment(
        name=path.stem,
        title=head.title,
        duration_ticks=ticks["duration"],
        controller_ticks=ticks["controller"],
        scale_ticks=ticks["scale"],
        plant=checked["plant"],
        contact=checked["contact"],
        scale=checked["scale"],
        cosim=checked["cosim"],
        controller=checked["controller"],
        reference=checked["reference"],
        drives=(one, two, three),
        values=source.values,
        origins=source.origins,
    )


def _fill_from_robot(values: dict[str, Any]) -> None:
    """[plant] and [controller.model] are the robot's own values wherever they do not say otherwise."""
    robot = values.get("robot")
    if not isinstance(robot, dict):
        return
    plant, controller = values.setdefault("plant", {}), values.setdefault("controller", {})
    if isinstance(plant, dict):
        values["plant"] = {**robot, **plant}
    if isinstance(controller, dict):
        model = controller.get("model", {})
        if isinstance(model, dict):
            known = keys(schema.Model)
            controller["model"] = {**{k: v for k, v in robot.items() if k in known}, **model}


def _checked(values: dict[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """The tables that are right, and the mistakes of the others."""
    checked: dict[str, Any] = {}
    mistakes: list[str] = []
    head = {key: value for key, value in values.items() if key not in TABLES and key != "drive"}
    for key in list(head):
        if key not in keys(Head):
            mistakes.append(unknown(key, [*keys(Head), *TABLES, "drive"]))
            del head[key]
    models: dict[str, type[Section]] = {"head": Head, **TABLES}
    for name, model in models.items():
        table = head if name == "head" else values.get(name)
        if table is None:
            mistakes.append(f"missing table [{name}]")
            continue
        try:
            checked[name] = model.model_validate(table)
        except ValidationError as error:
            found = [sentence.replace("[head] ", "") for sentence in sentences(error, model, name)]
            # a mistake in [robot] is told once, not again for each table that is filled from it
            told = {mistake.partition("] ")[2] for mistake in mistakes if mistake.startswith("[robot]")}
            mistakes += [sentence for sentence in found if sentence.partition("] ")[2] not in told]
    return checked, mistakes


def _ticks(checked: dict[str, Any], mistakes: list[str]) -> dict[str, int]:
    """Durations and periods as whole ticks."""
    wanted = {
        "duration": ("head", "duration", "duration_s"),
        "controller": ("controller", "period", "[controller] period_ms"),
        "scale": ("scale", "period", "[scale] period_ms"),
    }
    if "cosim" not in checked:
        return {}
    tick = checked["cosim"].tick
    ticks = {}
    for name, (table, attribute, key) in wanted.items():
        if table in checked:
            length = getattr(checked[table], attribute)
            ticks[name] = round(length / tick)
            if ticks[name] < 1 or abs(ticks[name] * tick - length) > 1e-9 * length:
                mistakes.append(f"{key}: {length:g} s is not a whole number of ticks of {tick:g} s")
    return ticks


def _refuse_unreachable(checked: dict[str, Any], mistakes: list[str]) -> None:
    """The whole reference has to be within reach of the robot as it is and as its controller believes it."""
    if "reference" not in checked:
        return
    reference = checked["reference"]
    if len(reference.t) != len(reference.p):
        mistakes.append(f"[reference] {len(reference.t)} times and {len(reference.p)} points: expected as many of each")
        return
    models = [checked["plant"]] if "plant" in checked else []
    models += [checked["controller"].model] if "controller" in checked else []
    for model in models:
        geometry = Geometry(model.a, model.b, model.l_a, model.l_b)
        for number, point in enumerate(reference.p, start=1):
            if problem := _out_of_reach(geometry, np.array(point)):
                mistakes.append(f"[reference] way point {number}: {problem}")
                return
        for number, line in enumerate(_lines(reference.p), start=1):
            if problem := _out_of_reach(geometry, line):
                # the pose alone once more: its sentence names no index into the line
                at = _out_of_reach(geometry, np.array(problem.pose))
                mistakes.append(f"[reference] between way points {number} and {number + 1}: {at}")
                return


def _out_of_reach(geometry: Geometry, p_B: np.ndarray) -> Unreachable | None:
    try:
        joint_angles(geometry, p_B)
    except Unreachable as problem:
        return problem
    return None


def _lines(points: tuple[schema.Triple, ...]) -> list[np.ndarray]:
    """Each way point, with points on the line towards the next."""
    lines = []
    for start, end in zip(points, (*points[1:], points[-1]), strict=True):
        a, b = np.array(start), np.array(end)
        count = 1 + int(np.linalg.norm(b - a) / WAY_POINT_SPACING)
        lines.append(a + np.linspace(0.0, 1.0, count, endpoint=False)[:, None] * (b - a))
    return lines


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
