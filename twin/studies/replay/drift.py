"""When does a residual leave what it was? Page's cumulative sum over means of blocks.

E. S. Page, Continuous inspection schemes, Biometrika 41 (1954) 100; the two-sided form and its run lengths as in D. C.
Montgomery, Introduction to Statistical Quality Control, sec. 9.1. With r_n the mean residual of block n and r_0 that of
the beginning of the log,

    up_n   = max(0, up_(n-1)   + (r_n - r_0) - K),     low_n = max(0, low_(n-1) - (r_n - r_0) - K),

and the alarm is the first sum beyond H. K = tolerance + sigma / 2 and H = 5 sigma: a residual that wanders within the
tolerance never fills a sum; one that stays just at its edge, with independent normal means of deviation sigma, does by
chance once in 930 blocks on one side (Montgomery, table 9.3: 465 for both sides of an in-control mean).

Neighbouring samples of a residual say the same thing twice, and a sum would take that for evidence. Blocks are at least
twice its correlation time T_c, and at least `SHORTEST_BLOCK`. sigma is the deviation of a block's mean: that of single
samples at the beginning times sqrt(2 T_c / block) (M. S. Bartlett, J. R. Stat. Soc. 8 (1946) 27, for an exponential
autocorrelation), but at least that of the sensors' own rounding: at rest an encoder shows one count for minutes, and no
spread at all.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

SHORTEST_BLOCK = 1.0
"""s. Two taps of a massage: the force of the platform's acceleration and of viscous joints comes to nothing over a
motion that returns to where it began."""
DECISION_FACTOR = 5.0
"""H / sigma."""


@dataclass(frozen=True)
class Drift:
    """What became of one residual, in its own unit.

    Attributes:
        baseline, sigma: its mean r_0 at the beginning, and the deviation of a block's mean.
        block: its length (s).
        tolerance: changes of the mean up to this are none.
        t, mean: end (s) and mean residual of each block, (n,);
        up, low: the sums after it, (n,).
        alarm: end of the block that raised it (s); NaN: none did.
        since: when the sum that raised it began to grow (s).
        size: mean residual less r_0 since then.
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
        """Whether there was no alarm."""
        return bool(np.isnan(self.alarm))

    @property
    def slack(self) -> float:
        """K: how far a mean may be off before a sum begins to fill."""
        return self.tolerance + 0.5 * self.sigma

    @property
    def threshold(self) -> float:
        """H."""
        return DECISION_FACTOR * self.sigma


def drift(
    t: NDArray[np.float64], r: NDArray[np.float64], baseline: float, tolerance: float, sigma_least: float
) -> Drift | None:
    """The two-sided sum over a residual; None if there is no block after the beginning.

    Args:
        t, r: times (n,), s, ascending, and residual (n,).
        baseline: length of the beginning that says what is normal (s).
        tolerance: change of the mean that is no news, in the unit of r.
        sigma_least: deviation that the sensors' rounding alone amounts to, > 0, likewise.
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
    """Lag (s) at which the autocorrelation of r (n,) falls below 1/e; 0 for a residual that stands still.

    A beginning that is all one swing gives at most its own length.
    """
    centred = r - np.mean(r)
    if len(r) < 3 or not np.any(centred):
        return 0.0
    # padded to twice its length, so that its end does not meet its beginning
    power = np.abs(np.fft.rfft(centred, 2 * len(r))) ** 2
    autocorrelation = np.fft.irfft(power, 2 * len(r))[: len(r)] / np.sum(centred**2)
    below = np.flatnonzero(autocorrelation < np.exp(-1.0))
    return float(np.median(np.diff(t))) * float(below[0] if len(below) else len(r))


def _sum(steps: NDArray[np.float64]) -> NDArray[np.float64]:
    """sum_n = max(0, sum_(n-1) + steps_n)."""
    total = np.cumsum(steps)
    # as far above its deepest point so far as it is
    return total - np.minimum(0.0, np.minimum.accumulate(total))


def _block_means(
    t: NDArray[np.float64], r: NDArray[np.float64], block: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """End (s) and mean of each whole block that has at least half the samples of the fullest one."""
    if not len(t):
        return np.empty(0), np.empty(0)
    index = np.floor((t - t[0]) / block).astype(np.int64)
    # the last one is whole only by chance
    whole = index < index[-1]
    # only blocks with samples: a log may have hours without one
    blocks, member, count = np.unique(index[whole], return_inverse=True, return_counts=True)
    full = count >= 0.5 * np.max(count, initial=0)
    sums = np.bincount(member, weights=r[whole], minlength=len(blocks))
    return t[0] + (blocks[full] + 1) * block, sums[full] / count[full]
