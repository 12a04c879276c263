"""What the sensors' rounding alone makes of a residual: nothing below that can be told apart.

Each encoder is off by up to half a count and, over poses, evenly distributed in that range: a deviation of 1/sqrt(12)
count. At rest it does not average out.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.controller.belief import Belief
from twin.robot.sea import load_torque


class Rounding(NamedTuple):
    """Of one quantity, in its own unit.

    Attributes:
        bound: with every sensor half a step off, all in the same sense.
        deviation: with every sensor off at random.
    """

    bound: float
    deviation: float


def force_rounding(belief: Belief, J: NDArray[np.float64], resolution: float) -> Rounding:
    """Of estimated less measured pressing force (N), at the worst pose of a log.

    F_z = -e_z J^T tau_l with tau_l = k_s N eta (theta_m - N theta_l), Eq. 19 to 21.

    Args:
        belief: the estimator's. J: Jacobians (n, 9), rad/m, row by row. resolution: of the measurement (N).
    """
    of_z = np.abs(J[:, 2::3]) * load_torque(belief.k_s, belief.N, belief.eta, 1.0)
    motor, joint = _counts(belief)
    bound = np.max(np.sum(of_z, axis=1)) * (motor + belief.N * joint) / 2.0 + resolution / 2.0
    variance = np.max(np.sum(of_z**2, axis=1)) * (motor**2 + (belief.N * joint) ** 2) + resolution**2
    return Rounding(float(bound), float(np.sqrt(variance / 12.0)))


def angle_rounding(belief: Belief) -> Rounding:
    """Of a joint angle of the plant model less that of the log (rad): a free link follows its motor, theta_m / N."""
    motor, joint = _counts(belief)
    return Rounding((motor / belief.N + joint) / 2.0, float(np.hypot(motor / belief.N, joint) / np.sqrt(12.0)))


def _counts(belief: Belief) -> tuple[float, float]:
    """A count of the motor and of the joint encoders, rad."""
    return 2.0 * np.pi / belief.motor_counts, 2.0 * np.pi / belief.joint_counts
