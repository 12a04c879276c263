"""Coefficient of friction from sweeps under load: how hard the robot pulls sideways while it slides.

While the head slides with the velocity v along a level scale, the force by the robot on it is F_t = mu F v/|v|, the
edge of the cone of (P10). F_t comes from the identified springs by statics, F from the scale. What the zeros leave in
F_t is the same in both directions of a sweep, so it is a constant of its own: F_t = mu F v/|v| + beta.

k_s by itself, from the torque of the motors: the one measurement that parts it from eta. A motor that turns slowly
holds the spring and its own friction, tau_motor = k_s d + f sign(theta_m') + beta, with the deflection d less its dead
zone (18). eta is then k_s eta / k_s.
"""

import numpy as np
from numpy.typing import NDArray

from twin.kernel.recording.logs.log import Log, LogRefused
from twin.robot.controller.controller import Belief
from twin.studies.identify.balance import deflections, loaded, on_scale, pose, pressing_force
from twin.studies.identify.fit import Fit, line
from twin.studies.identify.windows import BACKLASH, JOINT_ZERO, Estimate, Windows

SLIDING = 1e-3
"""m/s: slower is rest."""
WIDEST = 0.1
"""A coefficient less sure than this is no number."""
SETTLED = 0.35
"""s in one direction, in which even the slowest sweep is past the 0.3 mm that bristles stretch."""


def friction(springs: Fit, seen: Windows, belief: Belief) -> Estimate | None:
    """Coefficient of friction mu from the windows in which the head slides; None if it never does.

    Args:
        springs: identified; how unsure they are goes into the interval.
        seen: windows in order of time.
        belief: geometry, masses, N.
    """
    at = pose(belief, seen.joint - springs.x[JOINT_ZERO : JOINT_ZERO + 3])
    v = np.linalg.solve(at.J, seen.speed[..., None])[..., 0]
    sliding = _sliding(seen, v[:, :2])
    if not np.any(sliding):
        return None
    swept = seen.where(sliding)
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
    return Estimate(float(found.coefficients[0]), width, "1") if width < WIDEST else None


def _equations(force: NDArray[np.float64], along: NDArray[np.float64]) -> NDArray[np.float64]:
    """What multiplies mu and beta in F_t (2n, 3); `along` (n, 2): direction of each window's motion."""
    A = np.zeros((2 * len(force), 3))
    A[:, 0] = (force[:, None] * along).ravel()
    A[0::2, 1] = A[1::2, 2] = 1.0
    # a sweep one way only cannot tell a false zero from friction, and takes the zeros as they were identified
    both = np.linalg.norm(along.mean(axis=0)) < 0.7
    return A if both else A[:, :1]


def _sliding(seen: Windows, v: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Windows (n,) on the scale that have gone on in one direction for `SETTLED` already; v (n, 2), m/s."""
    speed = np.linalg.norm(v, axis=1)
    moving = np.flatnonzero(on_scale(seen) & (speed > SLIDING))
    heading = v[moving] / speed[moving, None]
    straight = np.sum(heading[1:] * heading[:-1], axis=1) > 0.9
    sliding = np.zeros(len(seen.t), dtype=bool)
    if len(moving):
        for run in seen.runs(moving, straight):
            sliding[run[seen.t[run] > seen.t[run[0]] + SETTLED]] = True
    return sliding


def spring_stiffness(springs: Fit, belief: Belief, log: Log) -> Estimate | None:
    """k_s (N m/rad) from drive/1.tau_motor to drive/3.tau_motor of `log`; None if the torque does not vary.

    Args:
        springs: identified; how unsure they are goes into the interval.
        belief: N.

    Raises:
        LogRefused: a torque is missing, or in another unit.
    """
    seen = springs.seen
    torque = np.stack([_mean(log, f"drive/{i}.tau_motor", seen) for i in (1, 2, 3)], axis=1).ravel()

    def equations(x: NDArray[np.float64]) -> NDArray[np.float64]:
        A = np.zeros((3 * len(seen.t), 7))
        A[:, 0] = loaded(deflections(x, seen, belief.N), x[BACKLASH]).ravel()
        for i in range(3):
            A[i::3, 1 + i] = np.sign(seen.speed[:, i])
            A[i::3, 4 + i] = 1.0
        return A

    found = line(equations(springs.x), torque, np.repeat(seen.cluster, 3))
    if found is None:
        return None
    through = springs.half_width_through(lambda x: float(np.linalg.pinv(equations(x))[0] @ torque))
    return Estimate(float(found.coefficients[0]), float(np.hypot(found.half_widths[0], through)), "N m/rad")


def _mean(log: Log, name: str, seen: Windows) -> NDArray[np.float64]:
    """Means of a torque over the windows."""
    if name not in log.series:
        raise LogRefused(
            f"{log.path}: '{name}' is not there; --motor-torque needs the torques of all three motors: choose with "
            f"--map {name}=COLUMN[N m]"
        )
    series = log.series[name]
    if series.unit != "N m":
        raise LogRefused(f"{log.path}: {name} is in '{series.unit}', expected 'N m'; a current is not a torque")
    total = np.concatenate([[0.0], np.cumsum(series.values)])
    first = np.searchsorted(series.t, seen.t - 0.5 * seen.length)
    last = np.maximum(np.searchsorted(series.t, seen.t + 0.5 * seen.length), first + 1)
    last = np.minimum(last, len(series.t))
    return (total[last] - total[first]) / np.maximum(last - first, 1)
