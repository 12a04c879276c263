"""The keys of an experiment file as its schema has them, in the words of docs/keys.md."""

from typing import Any, Literal, get_args, get_origin

import annotated_types
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from twin.experiment import (
    change,
    contact,
    experiment,
    fault,
    measure,
    monitor,
    reference,
    schema,
    stand_in,
    task,
    tissue,
)
from twin.experiment.quantity import Section
from twin.experiment.robot import Plant, Robot

TABLES: dict[str, type[Section]] = {
    "top of the file": experiment.Head,
    "[robot]": Robot,
    "[plant]": Plant,
    "[cosim]": schema.Cosim,
    "[drive]": schema.Drive,
    "[drive.velocity_loop]": schema.VelocityLoop,
    "[drive.parts.NAME]": schema.Part,
    "[contact]": contact.Contact,
    "[contact.breathing]": contact.Breathing,
    "[contact.shift]": contact.Shift,
    "[scale]": schema.Scale,
    "[recording]": schema.Recording,
    "[controller]": schema.Controller,
    "[controller.position]": schema.PositionLoop,
    "[controller.force]": schema.ForceLoop,
    "[[controller.force.schedule]]": tissue.ScheduledGains,
    "[controller.tissue]": tissue.Tissue,
    "[controller.breath]": tissue.Breath,
    "[controller.touch]": schema.Touch,
    "[controller.feed_forward]": schema.FeedForward,
    "[controller.damping]": schema.Damping,
    "[controller.energy_tank]": schema.EnergyTank,
    "a part of another make": stand_in.StandIn,
    "[reference]": reference.Reference,
    "[reference.circle]": reference.Circle,
    "[reference.chirp]": reference.Chirp,
    "[reference.joint_step]": reference.JointStep,
    "[approach]": task.Approach,
    '[[task]] kind = "press"': task.Press,
    '[[task]] kind = "tap"': task.Tap,
    '[[task]] kind = "roll"': task.Roll,
    '[[task]] kind = "push"': task.Push,
    "[monitor]": monitor.Monitor,
    "[[fault]]": fault.FaultTable,
    "[[change]]": change.ChangeTable,
    **{f'[[measure]] kind = "{kind}"': table for kind, table in measure.KINDS.items()},
}
SIGNS = {annotated_types.Gt: ">", annotated_types.Ge: ">=", annotated_types.Lt: "<", annotated_types.Le: "<="}


def rows(model: type[Section]) -> dict[str, tuple[str, str, str]]:
    """key -> (unit, default, allowed), each as docs/keys.md writes it; only keys that its base does not have."""
    inherited = Robot.model_fields if model is Plant else {}
    return {
        field.alias or name: (_unit(name, field), _default(field), _allowed(field))
        for name, field in model.model_fields.items()
        if name not in inherited and not _is_table(field)
    }


def _is_table(field: FieldInfo) -> bool:
    """Whether the key opens a table that has rows of its own."""
    kinds = (field.annotation, *get_args(field.annotation))
    return any(isinstance(kind, type) and issubclass(kind, Section) for kind in kinds)


def _unit(name: str, field: FieldInfo) -> str:
    if field.alias is None:
        return ""
    over, *under = [
        " ".join(part.replace("Nm", "N_m").strip("_").split("_"))
        for part in field.alias.removeprefix(f"{name}_").split("per")
    ]
    below = " per ".join(f"({part})" if " " in part and len(under) == 1 else part for part in under)
    return f"{over or '1'}/{below}" if below else over


def _default(field: FieldInfo) -> str:
    if field.default is PydanticUndefined:
        return "" if field.default_factory else "needed"
    match field.default:
        case None:
            return ""
        case bool(value):
            return str(value).lower()
        case str(value):
            return f'"{value}"'
        case tuple(value):
            return str([int(part) if part == int(part) else part for part in value])
        case value:
            return f"{value:g}"


def _allowed(field: FieldInfo) -> str:
    kind: Any = next((k for k in get_args(field.annotation) if get_origin(k) is Literal), field.annotation)
    if get_origin(kind) is Literal:
        return ", ".join(f'"{value}"' if isinstance(value, str) else str(value) for value in get_args(kind))
    bounds = [
        f"{SIGNS[type(bound)]} {_limit(bound):g}"
        for bound in field.metadata
        if type(bound) in SIGNS and _limit(bound) < 2**62
    ]
    return ", ".join(bounds)


def _limit(bound: Any) -> float:
    return getattr(bound, {">": "gt", ">=": "ge", "<": "lt", "<=": "le"}[SIGNS[type(bound)]])
