"""Drive contract: the ports that every drive offers, and components that complete a drive without some of them."""

import math
from typing import Literal, NamedTuple

import numpy as np

from twin.kernel.cosim.component import NativeComponent, step_function
from twin.kernel.cosim.port import Port, memory_of, record, state
from twin.kernel.fmi.variable import SPEED_DIMENSION
from twin.kernel.units import CURRENT, NUMBER, POWER, TEMPERATURE, TORQUE, VOLTAGE, Dimension

Command = Literal["velocity", "torque", "current", "voltage", "position"]

ROTOR_MEMORY = record(J="f8", b="f8", theta=state("f8"), omega=state("f8"))
UNWRAP_INPUTS = (Port("wrapped", 1, "rad", "motor angle, but for whole turns of the servo"),)
UNWRAP_MEMORY = record(turn="f8", theta=state("f8"))


class Role(NamedTuple):
    """A quantity of the drive contract, such as the commanded speed or the shaft angle.

    Attributes:
        port: name, SI unit and meaning.
        causality: causality in FMI's terms.
        required: whether a drive must have it.
        synonyms: suppliers' names for it, used to propose a mapping.
        mechanical: effect of sign and gear ratio: 1 for an angle or speed (the FMU's shaft turns `gear_ratio` times as
            far), -1 for a torque (divided by it), 0 without effect.
    """

    port: Port
    causality: Literal["input", "output"]
    dimension: Dimension
    required: bool
    synonyms: tuple[str, ...]
    mechanical: Literal[-1, 0, 1] = 0


COMMAND_ROLES: dict[Command, Role] = {
    "velocity": Role(
        Port("omega_ref", 1, "rad/s", "commanded motor speed"), "input", SPEED_DIMENSION, True,
        ("omega_ref", "speed_ref", "n_cmd", "velocity", "goal", "target", "setpoint", "cmd", "ref"), 1,
    ),
    "torque": Role(
        Port("command", 1, "N m", "commanded motor torque"), "input", TORQUE, True,
        ("tau_cmd", "tau_ref", "torque_ref", "torque_cmd", "cmd", "ref", "setpoint", "target"), -1,
    ),
    "current": Role(
        Port("command", 1, "A", "commanded motor current"), "input", CURRENT, True,
        ("i_ref", "i_cmd", "current_ref", "iq_ref", "cmd", "ref", "setpoint"),
    ),
    "voltage": Role(
        Port("command", 1, "V", "commanded motor voltage"), "input", VOLTAGE, True,
        ("u_cmd", "v_cmd", "u_ref", "voltage", "u", "v", "cmd", "ref"),
    ),
    "position": Role(
        Port("command", 1, "rad", "commanded motor angle"), "input", NUMBER, True,
        ("theta_ref", "phi_ref", "position_ref", "goal_position", "q_ref", "position", "angle", "cmd", "ref"), 1,
    ),
}  # fmt: skip
"""The command role, by kind of command."""

LOAD_ROLE = Role(
    Port("tau_load", 1, "N m", "load on the motor shaft, positive opposes +omega_m"), "input", TORQUE, True,
    ("tau_load", "load", "m_load", "torque_load", "load_torque", "disturbance", "external"), -1,
)  # fmt: skip

THETA_M_ROLE = Role(
    Port("theta_m", 1, "rad", "motor angle"), "output", NUMBER, True,
    ("theta_m", "phi", "angle", "position", "theta", "q"), 1,
)  # fmt: skip
OMEGA_M_ROLE = Role(
    Port("omega_m", 1, "rad/s", "motor speed"), "output", SPEED_DIMENSION, True,
    ("omega_m", "speed", "velocity", "omega", "n", "w"), 1,
)  # fmt: skip
TAU_MOTOR_ROLE = Role(
    Port("tau_motor", 1, "N m", "torque the machine produces"), "output", TORQUE, False,
    ("tau_motor", "motor_torque", "torque", "tau_m", "tau", "m_mot"), -1,
)  # fmt: skip
OUTPUT_ROLES = (
    THETA_M_ROLE,
    OMEGA_M_ROLE,
    TAU_MOTOR_ROLE,
    Role(Port("current", 1, "A", "motor current"), "output", CURRENT, False, ("current", "i_q", "iq", "i_a", "i")),
    Role(Port("power", 1, "W", "electrical power drawn"), "output", POWER, False, ("power", "p_el", "p")),
    Role(
        Port("temperature", 1, "K", "winding temperature"), "output", TEMPERATURE, False,
        ("temperature", "t_w", "winding", "temp"),
    ),
    Role(Port("status", 1, "1", "status code of the drive"), "output", NUMBER, False, ("status", "state", "error")),
)  # fmt: skip

OPTIONAL_INPUT_ROLES = (
    Role(Port("enable", 1, "1", "drive enabled"), "input", NUMBER, False, ("enable", "enabled", "on")),
    Role(Port("v_bus", 1, "V", "voltage of the supply"), "input", VOLTAGE, False, ("v_bus", "v_dc", "u_bus", "supply")),
)
"""Inputs that only some drives have; a value in [drive.parameters] replaces their start value."""

SHAFT_INPUT_ROLES = tuple(role._replace(causality="input", required=False) for role in (OMEGA_M_ROLE, THETA_M_ROLE))
"""Inputs for the shaft's motion, of a drive whose rotor is simulated here."""


def drive_roles(command: Command, rotor: bool = False) -> tuple[Role, ...]:
    """Return every quantity that a drive exchanges with the robot, inputs first, for a kind of command.

    With a `rotor`, twin simulates the shaft: the FMU outputs a torque, and may have inputs for the shaft's motion.
    """
    if not rotor:
        return (COMMAND_ROLES[command], LOAD_ROLE, *OPTIONAL_INPUT_ROLES, *OUTPUT_ROLES)
    moved = tuple(role for role in OUTPUT_ROLES if role not in (THETA_M_ROLE, OMEGA_M_ROLE, TAU_MOTOR_ROLE))
    return (
        COMMAND_ROLES[command],
        *SHAFT_INPUT_ROLES,
        *OPTIONAL_INPUT_ROLES,
        TAU_MOTOR_ROLE._replace(required=True),
        *moved,
    )


ROTOR_INPUTS = (TAU_MOTOR_ROLE.port, LOAD_ROLE.port)
ROTOR_OUTPUTS = (THETA_M_ROLE.port, OMEGA_M_ROLE.port)


@step_function(ROTOR_MEMORY, ROTOR_INPUTS, ROTOR_OUTPUTS)
def rotor_step(m, t, h, u, y):
    # exact solution of J d omega/dt = tau_motor - tau_load - b omega for torques held over the step
    alpha = (u.tau_motor - u.tau_load - m.b * m.omega) / m.J
    x = m.b * h / m.J
    # first two phi functions of exponential integrators at -x; (1 - phi_1)/x would cancel for small x
    phi_1 = -math.expm1(-x) / x if x > 0.0 else 1.0
    phi_2 = (1.0 - phi_1) / x if x > 1e-2 else 0.5 - x / 6.0 * (1.0 - x / 4.0 * (1.0 - x / 5.0 * (1.0 - x / 6.0)))
    m.theta += h * (m.omega + h * alpha * phi_2)
    m.omega += h * alpha * phi_1
    y.theta_m, y.omega_m = m.theta, m.omega
    return 0


class DriveRotor(NativeComponent):
    """Continuous component of twin's motor shaft: torques in, angle and speed of the shaft out.

    `J` in kg m2 and `b` in N m per rad/s are at the motor shaft; it starts at rest at the angle `theta_m` (rad).
    """

    def __init__(self, J: float, b: float, theta_m: float):
        memory = memory_of(ROTOR_MEMORY, J=J, b=b, theta=theta_m)
        super().__init__("rotor", ROTOR_INPUTS, ROTOR_OUTPUTS, False, rotor_step, memory, np.array([theta_m, 0.0]))


UNWRAP_OUTPUTS = (THETA_M_ROLE.port,)


@step_function(UNWRAP_MEMORY, UNWRAP_INPUTS, UNWRAP_OUTPUTS)
def unwrap_step(m, t, h, u, y):
    # a shaft turns by less than half a turn within a step
    m.theta = u.wrapped - m.turn * round((u.wrapped - m.theta) / m.turn)
    y.theta_m = m.theta
    return 0


class AngleUnwrapper(NativeComponent):
    """Continuous component behind a drive's FMU: converts a wrapped angle to a continuous one.

    `turn` is one turn of the servo, as an angle of the motor shaft (rad); `theta_m` is the initial angle (rad).
    """

    def __init__(self, turn: float, theta_m: float):
        memory = memory_of(UNWRAP_MEMORY, turn=turn, theta=theta_m)
        super().__init__("unwrapped", UNWRAP_INPUTS, UNWRAP_OUTPUTS, False, unwrap_step, memory, np.array([theta_m]))
