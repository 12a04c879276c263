"""Times of any number in little memory, counted by compiled code or by Python."""

import math
from collections.abc import Sequence

import numpy as np

from twin.kernel.compiled.function import carray, njit, pointer_to

MIN_TIME, LOG_STEP, BIN_COUNT = 1e-6, math.log(1.02), 1200
_integers = pointer_to(np.int64)


@njit(cache=True)
def bin_of(seconds):
    """The bin of a time; below `MIN_TIME` it is the first one."""
    return min(int(math.log(seconds / MIN_TIME) / LOG_STEP) + 1, BIN_COUNT - 1) if seconds > MIN_TIME else 0


@njit(cache=True)
def count_in(bins, seconds):
    """Count a time in the bins at this address."""
    carray(_integers(bins), BIN_COUNT)[bin_of(seconds)] += 1


class Histogram:
    """Quantiles of times to 2 %.

    Attributes:
        bins: how many times are in each, (BINS,) int64.
        largest: s.
    """

    def __init__(self) -> None:
        self.bins = np.zeros(BIN_COUNT, dtype=np.int64)
        self.largest = 0.0

    def add(self, seconds: float) -> None:
        """One more time; below 0 it counts as 0."""
        self.bins[bin_of.__wrapped__(seconds)] += 1
        self.largest = max(self.largest, seconds)

    @property
    def count(self) -> int:
        """How many there are."""
        return int(self.bins.sum())

    def counts_below(self, bounds: Sequence[float]) -> list[int]:
        """How many of them are at most so long, for each of `bounds` (s), to 2 %."""
        sums = np.cumsum(self.bins)
        places = [math.floor(math.log(bound / MIN_TIME) / LOG_STEP) for bound in bounds]
        return [int(sums[min(max(place, 0), BIN_COUNT - 1)]) for place in places]

    def quantile(self, share: float) -> float:
        """The time (s) that so large a share of them does not exceed; NaN without any."""
        if not self.count:
            return math.nan
        place = int(np.searchsorted(np.cumsum(self.bins), share * self.count))
        return min(MIN_TIME * math.exp(LOG_STEP * place), self.largest) if place else min(MIN_TIME, self.largest)
