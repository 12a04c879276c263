"""How a metric is spread over the runs."""

from dataclasses import dataclass

import numpy as np

from twin.studies.sweep.columns import Columns, Numbers, once
from twin.studies.sweep.statistics.ranking import ROUNDING, value

QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
BINS = 12


@dataclass(frozen=True)
class Spread:
    """The numbers of a metric.

    Attributes:
        metric: its name.
        numbers: of the runs that have one, in the order of runs.
        missing: runs that have none.
        quantiles: at `QUANTILES`.
        counts: of `BINS` bins of equal width from the least number to the largest; of one bin around them all if they
            differ by no more than rounding.
        edges: of the bins, one more than these.
    """

    metric: str
    numbers: Numbers
    missing: int
    quantiles: tuple[float, ...]
    counts: tuple[int, ...]
    edges: Numbers


@once
def spread(columns: Columns, metric: str) -> Spread | None:
    """Over all finished runs, limits kept or not; None if none has the metric."""
    numbers = value(columns, metric)
    numbers = numbers[~np.isnan(numbers)]
    if len(numbers) == 0:
        return None
    counts, edges = np.histogram(numbers, *_bins(numbers))
    quantiles = tuple(float(number) for number in np.quantile(numbers, QUANTILES))
    return Spread(metric, numbers, len(columns) - len(numbers), quantiles, tuple(int(count) for count in counts), edges)


def _bins(numbers: Numbers) -> tuple[int, tuple[float, float]]:
    """(bins, range of them all): neighbouring doubles have nothing between them that twelve bins could share."""
    scale = max(1.0, float(np.abs(numbers).max()))
    low, high = float(numbers.min()), float(numbers.max())
    if high - low <= 10.0**-ROUNDING * scale:
        return 1, (low - 0.5 * scale, high + 0.5 * scale)
    return BINS, (low, high)
