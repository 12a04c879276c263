"""[plant] and [contact] as the constants of plant and encoders; [contact] and [[fault]] as how the surface moves."""

import math
from collections.abc import Sequence

from twin.experiment.fault import NEVER, Fault
from twin.plant.body import Motion, MotionKind
from twin.plant.contact_law import Contact
from twin.plant.encoder import Shaft
from twin.plant.parameters import PlantParameters, TrueRobot

SUDDEN = 0.02
"""Time (s) in which a surface jumps or drops away as a fault."""
BREATHING_RATE = 0.25
"""Of breathing as a fault (Hz): 15 per minute."""


def plant_parameters(plant: TrueRobot, contact: Contact) -> PlantParameters:
    """What is true, SI."""
    return PlantParameters.made(plant, contact)


def shafts(plant: TrueRobot) -> tuple[Shaft, Shaft]:
    """The encoders of the motors and of the joints."""
    p = plant
    return (
        Shaft(p.motor_counts_per_turn, p.motor_zero, p.motor_noise, p.motor_eccentricity, p.motor_eccentric_at),
        Shaft(p.joint_counts_per_turn, p.joint_zero, p.joint_noise, p.joint_eccentricity, p.joint_eccentric_at),
    )


def surface_motions(contact: Contact) -> tuple[Motion, ...]:
    """How the surface moves; empty: it does not."""
    return tuple(table.motion for table in contact.motions)


def fault_motions(faults: Sequence[Fault], tick: float) -> tuple[Motion, ...]:
    """How it moves because of those of `faults` that break the body; `tick` in s."""
    return tuple(motion for fault in faults if (motion := _broken(fault, tick)) is not None)


def _broken(fault: Fault, tick: float) -> Motion | None:
    onset, end = fault.onset * tick, math.inf if fault.end == NEVER else fault.end * tick
    up, down = (0.0, 0.0, fault.magnitude), (0.0, 0.0, -fault.magnitude)
    match fault.kind:
        case "surface_jump":
            return Motion(MotionKind.SHIFT, up, onset, end, rise=SUDDEN)
        case "contact_loss":
            return Motion(MotionKind.SHIFT, down, onset, end, rise=SUDDEN)
        case "breathing":
            return Motion(MotionKind.BREATHING, up, onset, end, rate=BREATHING_RATE)
    return None
