"""The estimator with Eq. 23 as it is printed, to show what that does to Fig. 4."""

import numpy as np

from twin.robot.controller.controller import ESTIMATE_RECORD, ESTIMATOR_INPUTS, ESTIMATOR_OUTPUTS, Belief, estimate
from twin.robot.mechanism.geometry import LEG_COS, LEG_SIN
from twin.robot.mechanism.statics import arm_gravity_torque, platform_weight


def rotation(angle: float) -> np.ndarray:
    """Rotation about z (Eq. 23)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


PRINTED = (np.eye(3), rotation(2 * np.pi / 3), rotation(-2 * np.pi / 3))
"""R_B-1, R_B-2, R_B-3 of Eq. 23 as printed; correct are the second and third swapped."""


class PrintedEstimator:
    """Takes the place of the estimator: everything as there, but the force by Eq. 21-27 with the printed Eq. 23."""

    inputs, outputs, sampled = ESTIMATOR_INPUTS, ESTIMATOR_OUTPUTS, True

    def __init__(self, belief: Belief):
        self.belief = belief

    def step(self, t: float, h: float, u: np.ndarray, y: np.ndarray) -> None:
        found = np.zeros(1, dtype=ESTIMATE_RECORD)
        e = found[0]
        estimate(self.belief, True, u[:3], u[3:], e)
        e["F_ee_B"] = printed_force(self.belief, e["theta_l"], e["p_B"], e["tau_l"])
        y[:-1] = found.view(np.float64)


def printed_force(belief: Belief, theta_l: np.ndarray, p_B: np.ndarray, tau_l: np.ndarray) -> np.ndarray:
    """Eq. 21-27 with the printed rotations, gravity-compensated like the product's estimator."""
    force = np.array([0.0, 0.0, -platform_weight(belief)])
    for i, R in enumerate(PRINTED):
        outward = np.array([LEG_COS[i], LEG_SIN[i], 0.0])
        knee = (belief.a - belief.b + belief.l_a * np.cos(theta_l[i])) * outward
        knee[2] = -belief.l_a * np.sin(theta_l[i])
        e = R @ ((p_B - knee) / np.linalg.norm(p_B - knee))
        tau = tau_l[i] + arm_gravity_torque(belief, belief, theta_l[i])
        F_A = tau / (belief.l_a * (np.sin(theta_l[i]) * e[1] - np.cos(theta_l[i]) * e[2]))
        # Eq. 26 turns back with R_B-3 for leg 2 and R_B-2 for leg 3: the inverse of R, whichever it is
        force += R.T @ (F_A * e)
    return force
