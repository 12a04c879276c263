"""What of an experiment's file decides on a part and cannot be set in it any more."""

from collections.abc import Sequence

from twin.experiment.experiment import Experiment
from twin.studies.build.fault_numbers import fault_beside, fault_of
from twin.studies.build.parameters import Parameter, said_in, senses
from twin.studies.build.part import RobotPart

_FIXED = {
    "plant": ("plant.substeps", "contact.law", "contact.shape"),
    "scale": ("scale.period_ms",),
    "latency": ("plant.encoder_latency_ms",),
    "encoder": ("seed", "controller.period_ms"),
    "estimator": ("controller.gravity_compensation", "controller.period_ms"),
    "controller": (
        "controller.mode", "controller.period_ms", "controller.speed_limit_rad_per_s", "controller.force.reference_N",
        "controller.force.trigger_N", "controller.force.trigger_time_s", "controller.touch.contact_N", "[reference]",
        "[approach]", "[[task]]", "controller.force.schedule",
    ),
    "tank": ("controller.period_ms",),
    "delay": ("controller.delay_ticks",),
    "monitor": ("[monitor]",),
}  # fmt: skip
"""What decides on a component and may be fixed in it; what is offered after all is not."""


def fixed(part: RobotPart, offered: Sequence[Parameter]) -> list[str]:
    """The keys of the experiment's file that decide on the part, and cannot be set any more."""
    open_ones = {parameter.key for parameter in offered}
    experiment = part.experiment
    keys: dict[str, None] = {}
    for component in part.components:
        fault = fault_of(experiment, component.name)
        if fault:
            said = (f"{component.name}.{key}" for key in said_in(experiment, component.name))
            keys |= dict.fromkeys((*said, *fault_beside(fault)))
        keys |= dict.fromkeys(key for key in _FIXED.get(component.name, ()) if _has(experiment, key))
    if senses(part):
        keys["[controller.model]"] = None
    return ["cosim.tick_ms", *(key for key in keys if key not in open_ones)]


def _has(experiment: Experiment, key: str) -> bool:
    """Whether the experiment says it, or has such a table."""
    table, _, name = key.strip("[]").rpartition(".")
    value = said_in(experiment, table).get(name)
    return bool(value) or value == 0
