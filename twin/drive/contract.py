"""What every drive FMU has to offer, whoever made it."""

from typing import Literal, NamedTuple

from twin.cosim.component import Port


class Dimension(NamedTuple):
    """Exponents of the SI base units, the radian counted as one of them (FMI 2.0, section 2.2.2)."""

    kg: int = 0
    m: int = 0
    s: int = 0
    A: int = 0
    K: int = 0
    mol: int = 0
    cd: int = 0
    rad: int = 0


class Role(NamedTuple):
    """A variable of the contract.

    Attributes:
        port: name, unit and meaning; the FMU's variable has the same name.
        causality: as FMI calls it.
        dimension: what its unit must be.
        required: whether a drive without it is refused.
    """

    port: Port
    causality: Literal["input", "output"]
    dimension: Dimension
    required: bool = True


ANGLE = Dimension(rad=1)
SPEED = Dimension(rad=1, s=-1)
TORQUE = Dimension(kg=1, m=2, s=-2)
CURRENT = Dimension(A=1)

ROLES = (
    Role(Port("omega_ref", 1, "rad/s", "commanded motor speed"), "input", SPEED),
    Role(Port("tau_load", 1, "N m", "load on the motor shaft, positive opposes +omega_m"), "input", TORQUE),
    Role(Port("theta_m", 1, "rad", "motor angle"), "output", ANGLE),
    Role(Port("omega_m", 1, "rad/s", "motor speed"), "output", SPEED),
    Role(Port("tau_motor", 1, "N m", "torque the machine produces"), "output", TORQUE, required=False),
    Role(Port("current", 1, "A", "motor current"), "output", CURRENT, required=False),
)
