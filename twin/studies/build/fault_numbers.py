"""Numbers of a [[fault]] that stay open in what is built of it; times are counted in ticks, and fixed."""

import math
from collections.abc import Iterator

import numpy as np

from twin.cosim.component import NativeComponent
from twin.experiment.experiment import Experiment
from twin.experiment.fault import Fault
from twin.experiment.fault_catalogue import CATALOGUE
from twin.faults.command_fault import CommandFault
from twin.faults.count_fault import CountFault, CountLaw
from twin.faults.drive_fault import DriveFault
from twin.faults.message_fault import MessageFault

_LOST = (CountLaw.DROPOUT_HOLD, CountLaw.DROPOUT_ZERO, CountLaw.DROPOUT_NAN)


def fault_of(experiment: Experiment, name: str) -> Fault | None:
    """The fault whose component is called `name`, `fault_1` of the first; None if that is no fault."""
    return next((fault for n, fault in enumerate(experiment.faults, start=1) if name == f"fault_{n}"), None)


def fault_numbers(
    experiment: Experiment, fault: Fault, component: NativeComponent
) -> Iterator[tuple[str, np.ndarray, float]]:
    """What of `fault` is a number in the memory of its `component`: its key, where it is, and times what.

    What is rounded, to counts or ticks, on its way there is not among them.
    """
    memory = component.memory[0:1]
    if isinstance(component, DriveFault) and fault.kind == "drive_runaway":
        yield "magnitude", memory["omega"], 1.0
    elif isinstance(component, CommandFault):
        yield "magnitude", memory["limit"], experiment.controller.speed_limit if fault.kind == "brown_out" else 1.0
    elif isinstance(component, CountFault):
        law = memory["law"][0]
        if law in (CountLaw.BIAS, CountLaw.GLITCH):
            of_motor, plant = component.inputs[0].name == "count_m", experiment.plant
            counts = plant.motor_counts_per_turn if of_motor else plant.joint_counts_per_turn
            yield "magnitude", memory["counts"], counts / (2.0 * math.pi)
        if law in _LOST or law == CountLaw.GLITCH:
            yield "share" if law == CountLaw.GLITCH else "magnitude", memory["share"], 1.0
    elif isinstance(component, MessageFault) and fault.kind == "sample_loss":
        yield "magnitude", memory["share"], 1.0


def fault_beside(fault: Fault) -> tuple[str, ...]:
    """Keys of other tables that decide on the component of `fault`."""
    match CATALOGUE[fault.kind].mechanism:
        case "counts":
            side = "motor" if fault.target.startswith("motor") else "joint"
            return (f"plant.{side}_counts_per_turn", "controller.period_ms")
        case "message":
            return ("controller.period_ms",)
        case "drive":
            return ("start.p_B",)
    return ("controller.speed_limit_rad_per_s",) if fault.kind == "brown_out" else ()
