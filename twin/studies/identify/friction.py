"""Coefficient of friction under the massage head, estimated from windows of sliding."""

import numpy as np
from numpy.typing import NDArray

from twin.robot.controller.controller import Belief
from twin.studies.identify.balance import pose, pressing_force
from twin.studies.identify.clustered import line
from twin.studies.identify.estimate import Estimate
from twin.studies.identify.fit import Fit
from twin.studies.identify.parameters import JOINT_ZERO
from twin.studies.identify.windows import Windows, on_scale

SLIDING_SPEED = 1e-3
"""Minimum speed of sliding (m/s)."""
MAX_MU_INTERVAL = 0.1
"""Maximum half width of a reported coefficient."""
SETTLED_TIME = 0.35
"""Minimum time in one direction (s): the slowest sweep passes the 0.3 mm of the bristles' stretch."""


def friction(springs: Fit, seen: Windows, belief: Belief) -> Estimate | None:
    """Estimate mu under the head from sliding windows in order of time; None without sliding."""
    at = pose(belief, seen.joint - springs.x[JOINT_ZERO : JOINT_ZERO + 3])
    v = np.linalg.solve(at.J, seen.speed[..., None])[..., 0]
    sliding = _sliding(seen, v[:, :2])
    if not np.any(sliding):
        return None
    swept = seen.select(sliding)
    along = v[sliding, :2] / np.linalg.norm(v[sliding, :2], axis=1, keepdims=True)
    A = _equations(swept.force, along)

    def sideways(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return pressing_force(x, swept, belief)[:, :2].ravel()

    found = line(A, sideways(springs.x), np.repeat(swept.cluster, 2))
    if found is None:
        return None
    mu = np.linalg.pinv(A)[0]
    through = springs.half_width_through(lambda x: float(mu @ sideways(x)))
    width = float(np.hypot(found.half_widths[0], through))
    return Estimate(float(found.coefficients[0]), width, "1") if width < MAX_MU_INTERVAL else None


def _equations(force: NDArray[np.float64], along: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the factors of mu and beta in F_t (2n, 3); `along` (n, 2): direction of each window's motion."""
    A = np.zeros((2 * len(force), 3))
    A[:, 0] = (force[:, None] * along).ravel()
    A[0::2, 1] = A[1::2, 2] = 1.0
    # one-way sweeps cannot separate zeros from friction, and use the identified zeros
    both = np.linalg.norm(along.mean(axis=0)) < 0.7
    return A if both else A[:, :1]


def _sliding(seen: Windows, v: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Mark the windows (n,) on the scale where the head moves in one direction for `SETTLED_TIME`; v (n, 2), m/s."""
    speed = np.linalg.norm(v, axis=1)
    moving = np.flatnonzero(on_scale(seen) & (speed > SLIDING_SPEED))
    heading = v[moving] / speed[moving, None]
    straight = np.sum(heading[1:] * heading[:-1], axis=1) > 0.9
    sliding = np.zeros(len(seen.t), dtype=bool)
    if len(moving):
        for run in seen.runs(moving, straight):
            sliding[run[seen.t[run] > seen.t[run[0]] + SETTLED_TIME]] = True
    return sliding
