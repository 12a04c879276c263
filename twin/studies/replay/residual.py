"""How far two courses of one quantity are apart: bias, spread, when, how late one is, and what rounding explains."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.recording.logs.log import in_gap
from twin.robot.controller.controller import Belief
from twin.robot.mechanism.statics import load_torque
from twin.robot.run.view import held_samples

MAX_LAG = 0.5
"""s. Beyond that two courses of a repeated motion match by mistake."""
MIN_LAG_STEP = 5e-3
"""s. What a force that changes within tenths of a second, with noise on it, can tell at best."""
MAX_LAG_PERIODS = 2_000_000
"""Sample periods over which a lag is looked for: some hours."""
STALE_PERIODS = 1.5
"""Sample periods after which an estimate is no longer the newest: one was lost."""
ROUNDING = 1e-9
"""Maximum rounding of recorded times (s)."""


@dataclass(frozen=True)
class Residual:
    """Differences `value - measured` at times.

    Attributes:
        t: of the measurements that have a value beside them (n,), s.
        value, measured: (n,), both in the unit of the quantity.
    """

    t: NDArray[np.float64]
    value: NDArray[np.float64]
    measured: NDArray[np.float64]

    @property
    def r(self) -> NDArray[np.float64]:
        """Value less measured, (n,)."""
        return self.value - self.measured


@dataclass(frozen=True)
class Statistics:
    """A residual in numbers, in the quantity's own unit.

    Attributes:
        bias, std, rms: mean, standard deviation about it, root mean square.
        largest, at: the residual of greatest size, with its sign, and when (s).
        correlation: Pearson's, of value and measurement; NaN where one of them stands still.
        lag: how much later the value is than the measurement (s), the peak of their cross-correlation; NaN likewise.
    """

    bias: float
    std: float
    rms: float
    largest: float
    at: float
    correlation: float
    lag: float


def residual(
    t: NDArray[np.float64],
    values: NDArray[np.float64],
    gaps: NDArray[np.float64],
    t_measured: NDArray[np.float64],
    measured: NDArray[np.float64],
) -> Residual:
    """`values` beside the measurements: at each, the newest value of that moment, unless it is stale or from a gap.

    Args:
        t: times of the values (n,), s, ascending.
        values: (n,).
        gaps: intervals (k, 2), s, in which values are missing.
        t_measured, measured: times and values of the measurement (m,).
    """
    newest = held_samples(t, t_measured)
    age = t_measured - t[newest]
    use = (age > -ROUNDING) & (age < STALE_PERIODS * np.median(np.diff(t))) & ~in_gap(t_measured, gaps)
    return Residual(t_measured[use], values[newest[use]], measured[use])


def statistics(residual: Residual) -> Statistics:
    """Of a residual with at least two entries."""
    r = residual.r
    worst = int(np.argmax(np.abs(r)))
    moves = min(np.ptp(residual.value), np.ptp(residual.measured)) > 0.0
    return Statistics(
        bias=float(np.mean(r)),
        std=float(np.std(r)),
        rms=float(np.sqrt(np.mean(r**2))),
        largest=float(r[worst]),
        at=float(residual.t[worst]),
        correlation=float(np.corrcoef(residual.value, residual.measured)[0, 1]) if moves else np.nan,
        lag=_lag(residual) if moves else np.nan,
    )


def _lag(residual: Residual) -> float:
    """The shift (s) under which value and measurement spread least about each other; NaN: not known, because most of
    what would be looked at is missing."""
    period = max(float(np.median(np.diff(residual.t))), MIN_LAG_STEP)
    if np.ptp(residual.t) > MAX_LAG_PERIODS * period:
        return np.nan
    grid = np.arange(residual.t[0], residual.t[-1] + 0.5 * period, period)
    value = np.interp(grid, residual.t, residual.value)
    measured = np.interp(grid, residual.t, residual.measured)
    most = min(int(MAX_LAG / period), len(grid) // 4)
    # the same stretch of the measurement for every shift, so that none has an easier one
    core = measured[most : len(measured) - most]
    spread = [np.std(value[most + k : most + k + len(core)] - core) for k in range(-most, most + 1)]
    return period * (int(np.argmin(spread)) - most)


class Rounding(NamedTuple):
    """What the sensors' rounding alone makes of a residual, in its own unit: smaller differences cannot be seen.

    Each encoder is off by up to half a count and, over poses, evenly distributed in that range: a deviation of
    1/sqrt(12) count. At rest it does not average out.

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
        belief: the estimator's.
        J: Jacobians (n, 9), rad/m, row by row.
        resolution: of the measurement (N).
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
