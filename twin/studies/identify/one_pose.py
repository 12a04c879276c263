"""Calibration by the paper's own procedure (Sec. III.A), and the causes of its bias.

"We allow the massage manipulator to touch the surface of the electronic scale, gradually increasing the z-axis
position. Comparing the force calculated via the proposed static force model with the force measured by the electronic
scale": one place, one press, and k_s eta scaled until F_z of (27) equals the scale's reading, a line through the
origin. (27) ignores the weight, the encoders' zeros, and the deflection in the dead zone; each of them is corrected in
turn here.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.robot.controller.controller import Belief
from twin.robot.mechanism.statics import platform_weight
from twin.studies.identify.balance import pose, subtract_dead_zone
from twin.studies.identify.parameters import BACKLASH, JOINT_ZERO, OFFSET
from twin.studies.identify.windows import Windows, on_scale

MIN_PRESS_RISE = 1.0
"""Minimum increase of the force in a press (N)."""
MAX_PRESS_WIDTH = 2e-3
"""Maximum lateral extent of a press (m); beyond it the motion is a sweep."""
PRINTED_STEP = "as printed"


class OnePose(NamedTuple):
    """Result of the paper's calibration procedure on one press.

    Attributes:
        place: position (2,), m.
        start, end: times (s).
        force: reading of the scale (n,), N.
        calculated: F_z of (27) with the believed k_s eta (n,), N.
        steps: k_s eta (N m/rad) by a line through the origin: as printed, then with one cause after the other
            corrected.
    """

    place: NDArray[np.float64]
    start: float
    end: float
    force: NDArray[np.float64]
    calculated: NDArray[np.float64]
    steps: dict[str, float]


def one_pose(seen: Windows, belief: Belief, x: NDArray[np.float64]) -> OnePose | None:
    """Apply the paper's calibration to the most central press; `x`: identified parameters; None without a press."""
    press = _press(seen, belief)
    if press is None:
        return None
    w = press.motor - belief.N * press.joint
    offset = np.subtract(belief.motor_zero, np.multiply(belief.N, belief.joint_zero))
    k, F = belief.k_s * belief.eta, press.force
    printed, weight = _pressing(k, w - offset, belief, press, np.array(belief.joint_zero))
    zeroed, own_weight = _pressing(k, w - x[OFFSET : OFFSET + 3], belief, press, x[JOINT_ZERO : JOINT_ZERO + 3])
    d = subtract_dead_zone(w - x[OFFSET : OFFSET + 3], x[BACKLASH])
    freed, _ = _pressing(k, d, belief, press, x[JOINT_ZERO : JOINT_ZERO + 3])
    steps = {
        PRINTED_STEP: k * _through_origin(printed, F),
        "weight taken off": k * _through_origin(printed, F - weight),
        "and the zeros": k * _through_origin(zeroed, F - own_weight),
        "and the dead zone": k * _through_origin(freed, F - own_weight),
    }
    p_B = pose(belief, press.joint - np.array(belief.joint_zero)).p_B
    return OnePose(p_B[:, :2].mean(axis=0), float(press.t[0]), float(press.t[-1]), F, printed, steps)


def _press(seen: Windows, belief: Belief) -> Windows | None:
    """Select the loading half of the press nearest to the base's axis, of equals the largest increase."""
    chosen = np.flatnonzero(on_scale(seen))
    if len(chosen) < 3:
        return None
    F = seen.force[chosen]
    p_B = pose(belief, seen.joint - np.array(belief.joint_zero)).p_B[:, :2]
    found = []
    for part in seen.runs(chosen, np.diff(F) > 0.0):
        rise, width = float(np.ptp(seen.force[part])), np.max(np.ptp(p_B[part], axis=0))
        if rise >= MIN_PRESS_RISE and width <= MAX_PRESS_WIDTH and len(part) >= 3:
            # rounded to 5 mm, so that repeated presses share a place
            distance = round(float(np.linalg.norm(p_B[part].mean(axis=0))) / 5e-3)
            found.append((distance, -rise, part))
    if not found:
        return None
    mask = np.zeros(len(seen.t), dtype=bool)
    mask[min(found, key=lambda one: one[:2])[2]] = True
    return seen.select(mask)


def _pressing(k, w, belief, press, joint_zero) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute -F_ee,z of (27) without weight for deflections w (n, 3), and the weight's part (n,), N."""
    at = pose(belief, press.joint - joint_zero)
    J_z = at.J[:, :, 2]
    return -np.sum(J_z * (k * belief.N * w), axis=1), platform_weight(belief) - np.sum(J_z * at.g_a, axis=1)


def _through_origin(calculated: NDArray[np.float64], force: NDArray[np.float64]) -> float:
    """Fit the slope s of the line force = s calculated through the origin, the factor of k_s eta."""
    return float(calculated @ force / (calculated @ calculated))
