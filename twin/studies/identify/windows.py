"""Windows of slow motion in a log, the only samples that determine statics.

Encoders are quantised. At rest every sample has the same rounding error, and a mean of thousands is not better than
one; in motion over several counts the errors cover their range, and their mean vanishes. A window is used if every
motor crosses some counts in it, and if it neither starts, stops nor reverses.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.recording.logs.log import LogError, in_gap
from twin.robot.controller.controller import Belief
from twin.studies.replay.samples import RobotSamples

WINDOW_LENGTH = 0.1
"""Minimum window length (s): below the 0.2 s of a press's sign changes, above a period of the free modes (75 rad/s)."""
MIN_COUNTS = 4.0
"""Minimum number of motor counts crossed in a window, averaged over the joints."""
MAX_ACCELERATION = 0.05
"""Maximum acceleration (m/s2): 0.3 kg give 0.015 N, a third of a scale's step; the balance includes nine tenths."""
JOINTS_PER_METRE = 17.0
"""d theta_l / d p_z at home (rad/m)."""
GUARD_TIME = 0.1
"""Maximum delay of a scale (s); until then contact is uncertain."""
CLUSTER_TIME = 2.0
"""Length of a cluster (s): closer windows share errors (place, press, encoder turn) and are not independent."""
MAX_AIR_FORCE = 0.05
"""Maximum force in free air (N), twice the step of the paper's scale."""
MIN_CONTACT_FORCE = 0.15
"""Minimum force throughout a window in contact (N)."""


class Windows(NamedTuple):
    """Windows of slow motion: means of angles, speeds and force over each window, SI.

    Attributes:
        t: middle of each (n,), s.
        motor, joint: encoder angles, zeros included (n, 3), rad.
        speed: speeds of the joints (n, 3), rad/s.
        acceleration: accelerations of the joints (n, 3), rad/s2.
        spread: half of the range of the deflection motor - N joint (n, 3), rad.
        force: force of the scale, pressing positive (n,), N.
        force_rate: slope of the force (n,), N/s.
        lowest, highest: extremes of the force in the window and for `GUARD_TIME` after it (n,), N.
        cluster: number of the cluster (n,), for the covariance.
        length: length of a window (s).
    """

    t: NDArray[np.float64]
    motor: NDArray[np.float64]
    joint: NDArray[np.float64]
    speed: NDArray[np.float64]
    acceleration: NDArray[np.float64]
    spread: NDArray[np.float64]
    force: NDArray[np.float64]
    force_rate: NDArray[np.float64]
    lowest: NDArray[np.float64]
    highest: NDArray[np.float64]
    cluster: NDArray[np.int64]
    length: float

    def select(self, chosen: NDArray[np.bool_]) -> "Windows":
        columns: dict[str, Any] = {name: getattr(self, name)[chosen] for name in self._fields if name != "length"}
        return self._replace(**columns)

    def runs(self, chosen: NDArray[np.intp], joined: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
        """Split the windows `chosen` (m,) into runs without a pause, also split at every False of `joined` (m - 1,).

        Two missing windows in a row are not a pause: a motor that crosses its backlash loses as many.
        """
        pause = np.diff(self.t[chosen]) > 3.5 * self.length
        return np.split(chosen, np.flatnonzero(pause | ~joined) + 1)


def windows(log: RobotSamples, belief: Belief) -> Windows:
    """Find the windows of slow motion in a log that are fit for statics; possibly an empty result.

    Raises:
        LogError: no force was measured, or never at the time of the encoders.
    """
    if log.force is None:
        raise LogError(
            f"{log.path}: no measured force: without it nothing ties the springs to a newton; name the scale's "
            "column with --map scale.F_z=COLUMN[N], pressing positive"
        )
    force = log.force
    length = max(WINDOW_LENGTH, 10.0 * log.sampling.period, 2.0 * float(np.median(np.diff(force.t))))
    bins = np.floor((log.t - log.t[0]) / length).astype(np.int64)
    known = (log.t >= force.t[0]) & (log.t <= force.t[-1]) & ~in_gap(log.t, force.sampling.gaps)
    F = np.interp(log.t, force.t, force.values)
    known &= np.isfinite(F) & np.all(np.isfinite(log.counts), axis=1)
    if not np.any(known):
        raise LogError(f"{log.path}: encoders and scale were never recorded at the same time")
    motor = log.only("count_m") * (2.0 * np.pi / belief.motor_counts)
    joint = log.only("count_l") * (2.0 * np.pi / belief.joint_counts)
    full, late = 0.8 * length / log.sampling.period, round(GUARD_TIME / log.sampling.period)
    rows = [
        _window(log.t[a:b], motor[a:b], joint[a:b], F[a:b], F[a : b + late], belief.N)
        for a, b in zip(*_edges(bins), strict=True)
        if b - a >= full and np.all(known[a:b])
    ]
    columns: list[Any] = [np.array(column) for column in zip(*rows, strict=True)] or [
        np.empty((0, 3) if wide else 0) for wide in (0, 1, 1, 1, 1, 1, 0, 0, 0, 0, 1)
    ]
    *means, travel = columns
    every = Windows._make([*means, np.floor(means[0] / CLUSTER_TIME).astype(np.int64), length])
    counts = np.mean(travel, axis=1) * belief.motor_counts / (2.0 * np.pi)
    calm = np.all(np.abs(every.acceleration) <= MAX_ACCELERATION * JOINTS_PER_METRE, axis=1)
    return every.select((counts >= MIN_COUNTS) & calm)


def _edges(bins: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Find the first and the past-the-last index of each run of equal `bins` (n,)."""
    turns = np.flatnonzero(np.diff(bins)) + 1
    return np.concatenate([[0], turns]), np.concatenate([turns, [len(bins)]])


def _window(t, motor, joint, F, F_and_later, N) -> tuple[object, ...]:
    """Compute the means over one window, a row of `Windows`, then the range of the motors (3,)."""
    half = len(t) // 2
    # slopes of both halves by regression, least sensitive to an encoder's steps
    first, last = (_slope(t[part], joint[part]) for part in (slice(None, half), slice(half, None)))
    acceleration = (last - first) / (t[half:].mean() - t[:half].mean())
    return (
        float(np.mean(t)), motor.mean(axis=0), joint.mean(axis=0), _slope(t, joint), acceleration,
        0.5 * np.ptp(motor - N * joint, axis=0), float(np.mean(F)), float(_slope(t, F)), float(np.min(F_and_later)),
        float(np.max(F_and_later)), np.ptp(motor, axis=0),
    )  # fmt: skip


def _slope(t: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
    centred = t - t.mean()
    return centred @ y / (centred @ centred)


def in_air(seen: Windows) -> NDArray[np.bool_]:
    return (seen.highest < MAX_AIR_FORCE) & (seen.lowest > -MAX_AIR_FORCE)


def on_scale(seen: Windows) -> NDArray[np.bool_]:
    """Check for each window (n,) whether the robot is in contact throughout."""
    return seen.lowest > MIN_CONTACT_FORCE
