"""Commanded speed into commanded angle, for drives that close a position loop of their own."""

import math
from typing import NamedTuple

from twin.cosim.component import NativeComponent
from twin.cosim.native import step_function
from twin.cosim.port import Port, memory_of, record_of

INPUTS = (
    Port("omega_ref", 1, "rad/s", "commanded motor speed"),
    Port("theta_m", 1, "rad", "motor angle, as the drive reports it"),
)
OUTPUTS = (
    Port("command", 1, "rad", "commanded motor angle"),
    Port("goal", 1, "rad", "the same angle from the zero of the servo, within its turn"),
)


class Servo(NamedTuple):
    """How a servo counts its angle phi, and what it may be told: phi = ratio (theta_m - zero).

    Attributes:
        zero: motor angle at phi = 0 (rad).
        ratio: turns of its shaft per turn of the motor shaft, negative if it turns the other way.
        lower, upper: limits of phi (rad).
        wrap: phi is counted from here over one turn (rad); infinite: it counts on.
        lead: most by which the commanded motor angle is ahead of the motor, either way (rad).
    """

    zero: float
    ratio: float
    lower: float = -math.inf
    upper: float = math.inf
    wrap: float = math.inf
    lead: float = math.inf


MEMORY = record_of(Servo, command="f8")


@step_function(MEMORY, INPUTS, OUTPUTS)
def step(m, t, h, u, y):
    # where it has to be when the next command comes
    command = m.command + u.omega_ref * h
    command = min(max(command, u.theta_m - m.lead), u.theta_m + m.lead)
    phi = min(max(m.ratio * (command - m.zero), m.lower), m.upper)
    m.command = m.zero + phi / m.ratio
    if m.wrap < math.inf:
        phi = m.wrap + (phi - m.wrap) % math.tau
    y.command = m.command
    y.goal = phi / m.ratio
    return 0


class DriveSpeedIntegrator(NativeComponent):
    """Sampled component: speed in, angle of the drive out. What limit and lead take away is not made up for later.

    Args:
        servo: what stands behind it.
        theta_m: motor angle at t = 0 (rad), where the command begins.
        period: in ticks of the drive's own system.
    """

    def __init__(self, servo: Servo, theta_m: float, period: int = 1):
        memory = memory_of(MEMORY, **servo._asdict(), command=theta_m)
        super().__init__("position_command", INPUTS, OUTPUTS, True, step, memory, period=period)
