"""The keys of an experiment file as its schema has them, in the words of docs/keys.md."""

from typing import Any, Literal, get_args, get_origin

import annotated_types
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from twin.controller.breath import Breath
from twin.controller.computer import Computer
from twin.controller.damping import Damping
from twin.controller.energy_tank import EnergyTank
from twin.controller.feed_forward import FeedForward
from twin.controller.loops import ForceLoop, PositionLoop, ScheduledGains
from twin.controller.task_controller import Touch
from twin.controller.tissue import Tissue
from twin.experiment import change, experiment, fault, measure, reference, schema, stand_in, task
from twin.monitor.limits import Monitor
from twin.plant.contact_law import Breathing, Contact, Shift
from twin.plant.parameters import Robot, TrueRobot
from twin.plant.scale import Display
from twin.settings import Settings

TABLES: dict[str, type[Settings]] = {
    "top of the file": experiment.Head,
    "[robot]": Robot,
    "[plant]": TrueRobot,
    "[cosim]": schema.Cosim,
    "[drive]": schema.Drive,
    "[drive.velocity_loop]": schema.VelocityLoop,
    "[drive.parts.NAME]": schema.Part,
    "[contact]": Contact,
    "[contact.breathing]": Breathing,
    "[contact.shift]": Shift,
    "[scale]": Display,
    "[recording]": schema.Recording,
    "[controller]": Computer,
    "[controller.position]": PositionLoop,
    "[controller.force]": ForceLoop,
    "[[controller.force.schedule]]": ScheduledGains,
    "[controller.tissue]": Tissue,
    "[controller.breath]": Breath,
    "[controller.touch]": Touch,
    "[controller.feed_forward]": FeedForward,
    "[controller.damping]": Damping,
    "[controller.energy_tank]": EnergyTank,
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
    "[monitor]": Monitor,
    "[[fault]]": fault.FaultTable,
    "[[change]]": change.ChangeTable,
    **{f'[[measure]] kind = "{kind}"': table for kind, table in measure.KINDS.items()},
}
SIGNS = {annotated_types.Gt: ">", annotated_types.Ge: ">=", annotated_types.Lt: "<", annotated_types.Le: "<="}


def rows(model: type[Settings]) -> dict[str, tuple[str, str, str]]:
    """key -> (unit, default, allowed), each as docs/keys.md writes it; only keys that its base does not have."""
    inherited = Robot.model_fields if model is TrueRobot else {}
    return {
        field.alias or name: (_unit(name, field), _default(field), _allowed(field))
        for name, field in model.model_fields.items()
        if name not in inherited and not _is_table(field)
    }


def _is_table(field: FieldInfo) -> bool:
    """Whether the key opens a table that has rows of its own."""
    kinds = (field.annotation, *get_args(field.annotation))
    return any(isinstance(kind, type) and issubclass(kind, Settings) for kind in kinds)


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
