"""Running statistics of a residual."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass
class RunningStatistics:
    """Running statistics of one residual of a session, or of the difference between two forces.

    Attributes:
        mean, rms: mean and root mean square of all values.
        largest, largest_time: value of largest size, and its time (s).
        recent: mean over the last second.
        last: time of the last value (s).
        worst, worst_at: largest size reached by the means of two consecutive seconds, with its sign, and their start
            (s).
    """

    count: int = 0
    largest: float = 0.0
    largest_time: float = math.nan
    _sum: float = 0.0
    _squares: float = 0.0
    _block: list[float] = field(default_factory=lambda: [0.0, 0.0, -math.inf])
    recent: float = math.nan
    last: float = -math.inf
    worst: float = 0.0
    worst_at: float = math.nan

    def add(self, t: NDArray[np.float64], r: NDArray[np.float64]) -> None:
        """Add residuals r (n,) at t (n,), s, to the running statistics; NaN is skipped."""
        there = np.isfinite(r)
        if not np.any(there):
            return
        t, r = t[there], r[there]
        self.count += len(r)
        self.last = float(t[-1])
        self._sum += float(np.sum(r))
        self._squares += float(np.sum(r**2))
        worst = int(np.argmax(np.abs(r)))
        if abs(r[worst]) > abs(self.largest) or not math.isfinite(self.largest_time):
            self.largest, self.largest_time = float(r[worst]), float(t[worst])
        if t[-1] - self._block[2] >= 1.0:
            if self._block[1]:
                before, self.recent = self.recent, self._block[0] / self._block[1]
                # one sample after a gap can dominate the mean of its second
                lasting = min(abs(before), abs(self.recent)) if math.isfinite(before) else 0.0
                if lasting > abs(self.worst):
                    self.worst, self.worst_at = math.copysign(lasting, self.recent), self._block[2] - 1.0
            self._block = [0.0, 0.0, float(t[-1])]
        self._block[0] += float(np.sum(r))
        self._block[1] += len(r)

    @property
    def mean(self) -> float:
        return self._sum / self.count if self.count else math.nan

    @property
    def rms(self) -> float:
        return math.sqrt(self._squares / self.count) if self.count else math.nan
