"""Detection of a changed mean: Page's cumulative sum over block means of a residual.

E. S. Page, Continuous inspection schemes, Biometrika 41 (1954) 100; the two-sided form and its run lengths as in D. C.
Montgomery, Introduction to Statistical Quality Control, sec. 9.1. With r_n the mean residual of block n and r_0 the
mean of the log's baseline,

    up_n   = max(0, up_(n-1)   + (r_n - r_0) - K),     low_n = max(0, low_(n-1) - (r_n - r_0) - K),

and the first sum beyond H is the alarm. K = tolerance + sigma / 2 and H = 5 sigma. A residual within the tolerance
never fills a sum; at the edge of the tolerance, with independent normal means of standard deviation sigma, one side has
a false alarm in 930 blocks (Montgomery, table 9.3: 465 for both sides of an in-control mean).

Neighbouring samples of a residual are correlated, so blocks have at least twice the correlation time T_c, and at least
`SHORTEST_BLOCK`. sigma, the standard deviation of a block's mean, is the samples' deviation in the baseline times
sqrt(2 T_c / block) (M. S. Bartlett, J. R. Stat. Soc. 8 (1946) 27, for an exponential autocorrelation), but at least the
deviation by the sensors' rounding: at rest an encoder may show one count for minutes, without any spread."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SHORTEST_BLOCK = 1.0
"""Minimum block length (s), two taps: acceleration and viscous friction cancel over a motion that returns."""
DECISION_FACTOR = 5.0
"""Threshold H by sigma."""


@dataclass(frozen=True)
class Drift:
    """Result of the test of one residual for a changed mean: the cumulative sums over time, in the residual's unit.

    Attributes:
        baseline, sigma: baseline mean r_0, and standard deviation of a block's mean.
        block: block length (s).
        tolerance: accepted change of the mean.
        t, mean: end (s) and mean residual of each block, (n,).
        up, low: sums after each block, (n,).
        alarm: end of the block with the alarm (s); NaN without an alarm.
        since: start of the growth of the alarming sum (s).
        size: mean residual since then, less r_0.
    """

    baseline: float
    sigma: float
    block: float
    tolerance: float
    t: NDArray[np.float64]
    mean: NDArray[np.float64]
    up: NDArray[np.float64]
    low: NDArray[np.float64]
    alarm: float
    since: float
    size: float

    @property
    def matches(self) -> bool:
        return bool(np.isnan(self.alarm))

    @property
    def slack(self) -> float:
        """Slack K of the cumulative sums: the change of a mean below which no sum grows."""
        return self.tolerance + 0.5 * self.sigma

    @property
    def threshold(self) -> float:
        return DECISION_FACTOR * self.sigma


def drift(
    t: NDArray[np.float64], r: NDArray[np.float64], baseline: float, tolerance: float, sigma_least: float
) -> Drift | None:
    """Test a residual for a changed mean by two-sided cumulative sums; None if no block follows the baseline.

    Args:
        t, r: times (n,), s, ascending, and residual (n,).
        baseline: length of the baseline (s).
        tolerance: accepted change of the mean, in the unit of r.
        sigma_least: standard deviation due to rounding, > 0, in the unit of r.
    """
    first = t < t[0] + baseline
    normal = r[first]
    T_c = correlation_time(t[first], normal)
    block = max(SHORTEST_BLOCK, 2.0 * T_c)
    r_0, sigma = float(np.mean(normal)), max(float(np.std(normal)) * np.sqrt(2.0 * T_c / block), sigma_least)
    ends, mean = _block_means(t[~first], r[~first], block)
    if not len(ends):
        return None
    K, H = tolerance + 0.5 * sigma, DECISION_FACTOR * sigma
    up, low = _sum(mean - r_0 - K), _sum(r_0 - mean - K)
    over = np.flatnonzero((up > H) | (low > H))
    alarm = since = size = np.nan
    if len(over):
        n = int(over[0])
        own = up if up[n] > H else low
        begun = int(np.max(np.flatnonzero(own[: n + 1] == 0.0), initial=-1)) + 1
        alarm, since = float(ends[n]), float(ends[begun] - block)
        size = float(np.mean(mean[begun : n + 1])) - r_0
    return Drift(r_0, sigma, block, tolerance, ends, mean, up, low, alarm, since, size)


def correlation_time(t: NDArray[np.float64], r: NDArray[np.float64]) -> float:
    """Compute the lag (s) where the autocorrelation of r (n,) is below 1/e; 0 if constant, at most the length of r."""
    centred = r - np.mean(r)
    if len(r) < 3 or not np.any(centred):
        return 0.0
    # zero padding avoids circular correlation
    power = np.abs(np.fft.rfft(centred, 2 * len(r))) ** 2
    autocorrelation = np.fft.irfft(power, 2 * len(r))[: len(r)] / np.sum(centred**2)
    below = np.flatnonzero(autocorrelation < np.exp(-1.0))
    return float(np.median(np.diff(t))) * float(below[0] if len(below) else len(r))


def _sum(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the cumulative sums sum_n = max(0, sum_(n-1) + steps_n)."""
    total = np.cumsum(steps)
    # the height above the running minimum
    return total - np.minimum(0.0, np.minimum.accumulate(total))


def _block_means(
    t: NDArray[np.float64], r: NDArray[np.float64], block: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Compute ends (s) and means of a residual's blocks with at least half the samples of the fullest."""
    if not len(t):
        return np.empty(0), np.empty(0)
    index = np.floor((t - t[0]) / block).astype(np.int64)
    # the last block is rarely complete
    whole = index < index[-1]
    # only blocks with samples, since gaps may last hours
    blocks, member, count = np.unique(index[whole], return_inverse=True, return_counts=True)
    full = count >= 0.5 * np.max(count, initial=0)
    sums = np.bincount(member, weights=r[whole], minlength=len(blocks))
    return t[0] + (blocks[full] + 1) * block, sums[full] / count[full]
