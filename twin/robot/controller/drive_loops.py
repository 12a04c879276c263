"""Loops before drives without a speed command: a PI for torque, current or voltage, an integrator for an angle."""

import math
from typing import NamedTuple

from twin.kernel.cosim.component import NativeComponent, step_function
from twin.kernel.cosim.port import Port, memory_of, record, record_of, state
from twin.robot.controller.pid import PID_RECORD, Gains, accept, loop_record, proposal

SPEED_LOOP_INPUTS = (
    Port("omega_ref", 1, "rad/s", "commanded motor speed"),
    Port("omega_m", 1, "rad/s", "motor speed, as the drive reports it"),
)
COMMAND_PORT = Port("command", 1, "SI", "what the drive takes: torque, current or voltage")
SPEED_LOOP_MEMORY = record(pid=PID_RECORD, limit="f8")
POSITION_INPUTS = (
    Port("omega_ref", 1, "rad/s", "commanded motor speed"),
    Port("theta_m", 1, "rad", "motor angle, as the drive reports it"),
)
POSITION_OUTPUTS = (
    Port("command", 1, "rad", "commanded motor angle"),
    Port("goal", 1, "rad", "the same angle from the zero of the servo, within its turn"),
)


@step_function(SPEED_LOOP_MEMORY, SPEED_LOOP_INPUTS, (COMMAND_PORT,))
def speed_loop_step(m, t, h, u, y):
    command, integral = proposal(m.pid, u.omega_ref - u.omega_m, h)
    if abs(command) <= m.limit:
        accept(m.pid, integral)
    y.command = min(max(command, -m.limit), m.limit)
    return 0


class DriveSpeedLoop(NativeComponent):
    """Sampled component of twin's velocity loop: speed error in, command of the drive, up to `limit`, out.

    `gains` convert rad/s to the command's SI unit; `period` is in ticks of the drive's own system.
    """

    def __init__(self, gains: Gains, limit: float, command: Port, period: int = 1):
        memory = memory_of(SPEED_LOOP_MEMORY, pid=loop_record(gains), limit=limit)
        super().__init__("velocity_loop", SPEED_LOOP_INPUTS, (command,), True, speed_loop_step, memory, period=period)


class Servo(NamedTuple):
    """Angle convention and limits of a position-controlled servo, whose angle is phi = ratio (theta_m - zero).

    Attributes:
        zero: motor angle at phi = 0 (rad).
        ratio: turns of its shaft per turn of the motor shaft, negative for the opposite direction.
        lower, upper: limits of phi (rad).
        wrap: start of the turn over which phi is counted (rad); infinity for unlimited counting.
        lead: maximum difference between commanded and actual motor angle, in either direction (rad).
    """

    zero: float
    ratio: float
    lower: float = -math.inf
    upper: float = math.inf
    wrap: float = math.inf
    lead: float = math.inf


POSITION_MEMORY = record_of(Servo, command=state("f8"))


@step_function(POSITION_MEMORY, POSITION_INPUTS, POSITION_OUTPUTS)
def position_step(m, t, h, u, y):
    # position at the time of the next command
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
    """Sampled component before a position-controlled drive: speed command in, angle command out.

    Motion cut by limits and lead is not made up for. The command starts at the motor angle `theta_m` (rad) of t = 0;
    `period` is in ticks of the drive's own system.
    """

    def __init__(self, servo: Servo, theta_m: float, period: int = 1):
        memory = memory_of(POSITION_MEMORY, **servo._asdict(), command=theta_m)
        super().__init__(
            "position_command", POSITION_INPUTS, POSITION_OUTPUTS, True, position_step, memory, period=period
        )
