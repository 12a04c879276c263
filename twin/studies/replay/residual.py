"""Residuals between two time series of one quantity: bias, spread, lag, and the effect of rounding."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.recording.logs.log import in_gap
from twin.robot.controller.controller import Belief
from twin.robot.mechanism.statics import load_torque
from twin.robot.run.view import held_samples

MAX_LAG = 0.5
"""Maximum lag (s); at larger lags periods of a repeated motion match each other."""
MIN_LAG_STEP = 5e-3
"""Minimum resolution of a lag (s), for noisy forces that change within tenths of a second."""
MAX_LAG_PERIODS = 2_000_000
"""Maximum length of a lag search in sample periods, some hours."""
STALE_PERIODS = 1.5
"""Maximum age of an estimate in sample periods; an older one precedes a lost sample."""
ROUNDING = 1e-9
"""Maximum rounding of recorded times (s)."""


@dataclass(frozen=True)
class Residual:
    """Residual `value - measured` of two series of one quantity, in its unit, at times `t` (n,), s."""

    t: NDArray[np.float64]
    value: NDArray[np.float64]
    measured: NDArray[np.float64]

    @property
    def r(self) -> NDArray[np.float64]:
        """Residual (n,), the value less the measurement."""
        return self.value - self.measured


@dataclass(frozen=True)
class Statistics:
    """Statistics of a residual, in the unit of its quantity.

    Attributes:
        bias, std, rms: mean, standard deviation, root mean square.
        largest, at: residual of largest size, with its sign, and its time (s).
        correlation: Pearson's correlation of value and measurement; NaN if one is constant.
        lag: delay of the value against the measurement (s), from their cross-correlation; NaN if one is constant.
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
    """Form a residual: pair each measurement with the newest value, except for stale values and gaps.

    Args:
        t: times of the values (n,), s, ascending.
        gaps: intervals without values (k, 2), s.
        t_measured, measured: times and values of the measurement (m,).
    """
    newest = held_samples(t, t_measured)
    age = t_measured - t[newest]
    use = (age > -ROUNDING) & (age < STALE_PERIODS * np.median(np.diff(t))) & ~in_gap(t_measured, gaps)
    return Residual(t_measured[use], values[newest[use]], measured[use])


def statistics(residual: Residual) -> Statistics:
    """Compute bias, spread, largest entry, correlation and lag of a residual with at least two entries."""
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
    """Estimate the lag (s) of value and measurement by the least spread of their difference; NaN if mostly gaps."""
    period = max(float(np.median(np.diff(residual.t))), MIN_LAG_STEP)
    if np.ptp(residual.t) > MAX_LAG_PERIODS * period:
        return np.nan
    grid = np.arange(residual.t[0], residual.t[-1] + 0.5 * period, period)
    value = np.interp(grid, residual.t, residual.value)
    measured = np.interp(grid, residual.t, residual.measured)
    most = min(int(MAX_LAG / period), len(grid) // 4)
    # the same part of the measurement for every shift, so that spreads are comparable
    core = measured[most : len(measured) - most]
    spread = [np.std(value[most + k : most + k + len(core)] - core) for k in range(-most, most + 1)]
    return period * (int(np.argmin(spread)) - most)


class Rounding(NamedTuple):
    """Effect of the sensors' rounding on a residual, in its unit: a lower limit of detectable differences.

    Each encoder is off by up to half a count, uniformly distributed over poses: a standard deviation of 1/sqrt(12)
    count. At rest it does not average out.

    Attributes:
        bound: effect with every sensor half a step off, all in the same sense.
        deviation: standard deviation with independent errors.
    """

    bound: float
    deviation: float


def force_rounding(belief: Belief, J: NDArray[np.float64], resolution: float) -> Rounding:
    """Compute the effect of rounding on estimated less measured pressing force (N), at the worst pose of a log.

    F_z = -e_z J^T tau_l with tau_l = k_s N eta (theta_m - N theta_l), Eq. 19 to 21.

    Args:
        J: Jacobians (n, 9), rad/m, row by row.
        resolution: resolution of the measurement (N).
    """
    of_z = np.abs(J[:, 2::3]) * load_torque(belief.k_s, belief.N, belief.eta, 1.0)
    motor, joint = _counts(belief)
    bound = np.max(np.sum(of_z, axis=1)) * (motor + belief.N * joint) / 2.0 + resolution / 2.0
    variance = np.max(np.sum(of_z**2, axis=1)) * (motor**2 + (belief.N * joint) ** 2) + resolution**2
    return Rounding(float(bound), float(np.sqrt(variance / 12.0)))


def angle_rounding(belief: Belief) -> Rounding:
    """Compute the effect of rounding on plant less log angles (rad): a free link follows its motor, theta_m / N."""
    motor, joint = _counts(belief)
    return Rounding((motor / belief.N + joint) / 2.0, float(np.hypot(motor / belief.N, joint) / np.sqrt(12.0)))


def _counts(belief: Belief) -> tuple[float, float]:
    """Return the angle of one count of the motor encoders and of the joint encoders (rad)."""
    return 2.0 * np.pi / belief.motor_counts, 2.0 * np.pi / belief.joint_counts
