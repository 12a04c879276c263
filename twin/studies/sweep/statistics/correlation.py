"""Which parameters matter, from any design: rank correlation with its interval and the chance that it is none."""

import math
from dataclasses import dataclass

import numpy as np

from twin.studies.sweep.columns import Columns, Numbers, once
from twin.studies.sweep.statistics.ranking import parameter, value

LEAST = 4
"""Runs below which the interval has no width to speak of: its variance is 1 / (n - 3)."""
FEW = 30
"""Runs below which only a correlation of 0.36 and more is told from none at 5 %."""
_NORMAL_95 = 1.959963984540054
"""Quantile of the standard normal distribution at 0.975."""


@dataclass(frozen=True)
class Correlation:
    """Spearman's rank correlation of a parameter with a metric.

    Attributes:
        rho: -1 .. 1, positive if the metric rises with the parameter.
        low, high: 95 % interval.
        p: chance of as strong a one if the two had nothing to do with each other.
        runs: that it is of.
    """

    rho: float
    low: float
    high: float
    p: float
    runs: int


def rank_correlation(columns: Columns, label: str, metric: str) -> Correlation | None:
    """Over the runs of one drive that have both as numbers; None if these are too few or one of the two is constant.

    Sources: Spearman (1904), ties share the mean of their ranks. Interval: Fisher's z with the variance
    (1 + rho^2/2) / (n - 3) of Bonett and Wright (2000). p: Student's t with n - 2 degrees of freedom (Kendall and
    Stuart, Advanced Theory of Statistics 2, 31.19). It sees monotonic relations only.
    """
    x, y = parameter(columns, label), value(columns, metric)
    both = ~(np.isnan(x) | np.isnan(y))
    n = int(both.sum())
    if n < LEAST:
        return None
    x, y = _ranks(x[both]), _ranks_of(columns, metric) if n == np.isfinite(y).sum() else _ranks(y[both])
    if np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return None
    # takes a while to import, and most of this package does without
    from scipy.special import stdtr

    # ranks less their mean are halves of whole numbers, whose sums are exact: a perfect correlation is exactly 1
    x, y = x - 0.5 * (n + 1), y - 0.5 * (n + 1)
    rho = max(-1.0, min(1.0, float(x @ y) / math.sqrt(float(x @ x) * float(y @ y))))
    perfect = abs(rho) == 1.0
    # Fisher's z of a perfect correlation is infinite, and so are both ends
    z = math.copysign(math.inf, rho) if perfect else math.atanh(rho)
    half = _NORMAL_95 * math.sqrt((1.0 + 0.5 * rho * rho) / (n - 3))
    t = math.inf if perfect else abs(rho) * math.sqrt((n - 2) / (1.0 - rho * rho))
    return Correlation(rho, math.tanh(z - half), math.tanh(z + half), float(2.0 * stdtr(n - 2, -t)), n)


@once
def _ranks_of(columns: Columns, metric: str) -> Numbers:
    """Of the runs that have the metric: every parameter is held against it."""
    numbers = value(columns, metric)
    return _ranks(numbers[~np.isnan(numbers)])


def _ranks(numbers: Numbers) -> Numbers:
    """From 1 on; ties share the mean of theirs."""
    _, which, counts = np.unique(numbers, return_inverse=True, return_counts=True)
    ranks: Numbers = (np.cumsum(counts) - 0.5 * (counts - 1))[which]
    return ranks
