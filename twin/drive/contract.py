"""What every drive has to offer, whoever made it."""

from typing import Literal, NamedTuple

from twin.cosim.port import Port
from twin.drive.units import SPEED
from twin.units import CURRENT, NUMBER, POWER, TEMPERATURE, TORQUE, VOLTAGE, Dimension

Command = Literal["velocity", "torque", "current", "voltage", "position"]


class Role(NamedTuple):
    """A quantity of the contract.

    Attributes:
        port: name, SI unit and meaning.
        causality: as FMI calls it.
        dimension: what its unit has to measure.
        required: whether a drive without it is refused.
        synonyms: words by which suppliers call it, for the proposal of a mapping.
        mechanical: how sign and gear ratio act on it: 1 an angle or speed (the FMU's shaft turns `gear_ratio` times as
            far), -1 a torque (it carries that much less), 0 not at all.
    """

    port: Port
    causality: Literal["input", "output"]
    dimension: Dimension
    required: bool
    synonyms: tuple[str, ...]
    mechanical: Literal[-1, 0, 1] = 0


COMMANDS: dict[Command, Role] = {
    "velocity": Role(
        Port("omega_ref", 1, "rad/s", "commanded motor speed"), "input", SPEED, True,
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
"""The one command role, by what the drive is commanded with."""

LOAD = Role(
    Port("tau_load", 1, "N m", "load on the motor shaft, positive opposes +omega_m"), "input", TORQUE, True,
    ("tau_load", "load", "m_load", "torque_load", "load_torque", "disturbance", "external"), -1,
)  # fmt: skip

THETA_M = Role(
    Port("theta_m", 1, "rad", "motor angle"), "output", NUMBER, True,
    ("theta_m", "phi", "angle", "position", "theta", "q"), 1,
)  # fmt: skip
OMEGA_M = Role(
    Port("omega_m", 1, "rad/s", "motor speed"), "output", SPEED, True,
    ("omega_m", "speed", "velocity", "omega", "n", "w"), 1,
)  # fmt: skip
TAU_MOTOR = Role(
    Port("tau_motor", 1, "N m", "torque the machine produces"), "output", TORQUE, False,
    ("tau_motor", "motor_torque", "torque", "tau_m", "tau", "m_mot"), -1,
)  # fmt: skip
OUTPUTS = (
    THETA_M,
    OMEGA_M,
    TAU_MOTOR,
    Role(Port("current", 1, "A", "motor current"), "output", CURRENT, False, ("current", "i_q", "iq", "i_a", "i")),
    Role(Port("power", 1, "W", "electrical power drawn"), "output", POWER, False, ("power", "p_el", "p")),
    Role(
        Port("temperature", 1, "K", "winding temperature"), "output", TEMPERATURE, False,
        ("temperature", "t_w", "winding", "temp"),
    ),
    Role(Port("status", 1, "1", "status code of the drive"), "output", NUMBER, False, ("status", "state", "error")),
)  # fmt: skip

OPTIONAL_INPUTS = (
    Role(Port("enable", 1, "1", "drive enabled"), "input", NUMBER, False, ("enable", "enabled", "on")),
    Role(Port("v_bus", 1, "V", "voltage of the supply"), "input", VOLTAGE, False, ("v_bus", "v_dc", "u_bus", "supply")),
)
"""What some drives also want; a value in [drive.parameters] sets it, else its own start value stands."""

SHAFT = tuple(role._replace(causality="input", required=False) for role in (OMEGA_M, THETA_M))
"""What a drive with a rotor of ours is told of its shaft."""


def contract(command: Command, rotor: bool = False) -> tuple[Role, ...]:
    """Every role of a drive, inputs first.

    Args:
        command: what it is commanded with.
        rotor: whether the shaft is ours: the FMU gives a torque then, and may be told how the shaft moves.
    """
    if not rotor:
        return (COMMANDS[command], LOAD, *OPTIONAL_INPUTS, *OUTPUTS)
    moved = tuple(role for role in OUTPUTS if role not in (THETA_M, OMEGA_M, TAU_MOTOR))
    return (COMMANDS[command], *SHAFT, *OPTIONAL_INPUTS, TAU_MOTOR._replace(required=True), *moved)
