"""Unknowns of an identification: names, units, relevant size, and start of the search."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.robot.controller.controller import Belief

KAPPA, LOSS, RATE, OFFSET, JOINT_ZERO, BACKLASH, FRICTION, HEIGHT, SLOPE, COMPLIANCE, DAMPING, DELAY = (
    0, 1, 2, 3, 6, 9, 10, 11, 12, 14, 15, 16
)  # fmt: skip
"""Indices in a vector of parameters; offsets and joint zeros are three each, slopes two."""
PARAMETER_COUNT = 17


@dataclass(frozen=True)
class Parameter:
    """Unknown parameter of an identification.

    Attributes:
        name: name in facts; vectors count from 1.
        start: believed value.
        size: plausible error of the belief; a parameter is reported if it is known to a tenth of it.
    """

    name: str
    meaning: str
    unit: str
    start: float
    size: float


def parameters(belief: Belief, height: float) -> tuple[Parameter, ...]:
    """Create the unknowns in their order, starting from `belief` and a believed `height` of the scale (m)."""
    k = belief.k_s * belief.eta
    offsets = np.subtract(belief.motor_zero, np.multiply(belief.N, belief.joint_zero))
    degree = float(np.radians(1.0))
    return (
        Parameter("k_s_eta", "k_s eta", "N m/rad", k, k),
        Parameter("loss", "ln(eta) of a belt that loses by direction", "1", 0.0, 0.5),
        Parameter("loss_rate", "speed at which its losses turn over", "rad/s", 0.01, 0.05),
        *(Parameter(f"deflection_zero_{i + 1}", f"zero of deflection {i + 1}", "rad", float(offsets[i]), degree)
          for i in range(3)),
        *(Parameter(f"joint_zero_{i + 1}", f"zero of joint {i + 1}", "rad", belief.joint_zero[i], degree)
          for i in range(3)),
        Parameter("backlash", "backlash, half width", "rad", belief.backlash, 0.5 * degree),
        Parameter("b_j", "viscous friction of a joint", "N m s/rad", 0.0, 0.02),
        Parameter("height", "height of the scale", "m", height, 5e-3),
        *(Parameter(f"slope_{axis}", f"slope of the scale along {axis}", "rad", 0.0, degree) for axis in "xy"),
        Parameter("compliance", "compliance of the scale", "m/N", 1e-3, 1e-3),
        Parameter("damping", "damping of the scale", "s/m", 0.0, 10.0),
        Parameter("delay", "delay of the scale", "s", 0.0, 0.1),
    )  # fmt: skip


def starts(unknowns: tuple[Parameter, ...]) -> NDArray[np.float64]:
    return np.array([one.start for one in unknowns])


def sizes(unknowns: tuple[Parameter, ...]) -> NDArray[np.float64]:
    return np.array([one.size for one in unknowns])
