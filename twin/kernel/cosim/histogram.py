"""Histogram of durations in constant memory, filled by compiled code or Python."""

import math
from collections.abc import Sequence

import numpy as np

from twin.kernel.compiled.function import carray, njit, pointer_to

MIN_TIME, LOG_STEP, BIN_COUNT = 1e-6, math.log(1.02), 1200
_integers = pointer_to(np.int64)


@njit(cache=True)
def bin_of(seconds):
    """Return the histogram bin of a duration (s); bin 0 below `MIN_TIME`."""
    return min(int(math.log(seconds / MIN_TIME) / LOG_STEP) + 1, BIN_COUNT - 1) if seconds > MIN_TIME else 0


@njit(cache=True)
def count_in(bins, seconds):
    """Count a duration (s) in a histogram whose bins are at address `bins`."""
    carray(_integers(bins), BIN_COUNT)[bin_of(seconds)] += 1


class Histogram:
    """Durations per bin, (BIN_COUNT,) int64, and the largest (s); quantiles are accurate to 2 %."""

    def __init__(self) -> None:
        self.bins = np.zeros(BIN_COUNT, dtype=np.int64)
        self.largest = 0.0

    def add(self, seconds: float) -> None:
        """Add a duration (s) to the histogram; negative values count as 0."""
        self.bins[bin_of.__wrapped__(seconds)] += 1
        self.largest = max(self.largest, seconds)

    @property
    def count(self) -> int:
        return int(self.bins.sum())

    def counts_below(self, bounds: Sequence[float]) -> list[int]:
        """Return the number of durations at or below each of `bounds` (s), to 2 %."""
        sums = np.cumsum(self.bins)
        places = [math.floor(math.log(bound / MIN_TIME) / LOG_STEP) for bound in bounds]
        return [int(sums[min(max(place, 0), BIN_COUNT - 1)]) for place in places]

    def quantile(self, share: float) -> float:
        """Return the duration (s) that the fraction `share` does not exceed, to 2 %; NaN if the histogram is empty."""
        if not self.count:
            return math.nan
        place = int(np.searchsorted(np.cumsum(self.bins), share * self.count))
        return min(MIN_TIME * math.exp(LOG_STEP * place), self.largest) if place else min(MIN_TIME, self.largest)
