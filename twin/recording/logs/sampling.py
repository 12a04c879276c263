"""When samples were taken, and where some are missing."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

LONGEST = 1.5
"""An interval longer than this many median intervals is a gap: at least one sample was lost."""
REGULAR = 0.6
"""Share of intervals within half of the median that makes sampling regular. A clock that loses three samples in ten
at random keeps 0.7 of them; points placed at random have 0.35 (intervals of a Poisson process)."""


class Sampling(NamedTuple):
    """How a series is sampled.

    Attributes:
        period: median interval, s.
        regular: whether it has a clock; without one no interval is a gap.
        gaps: start and end (s) of each interval in which samples are missing, (k, 2).
    """

    period: float
    regular: bool
    gaps: NDArray[np.float64]

    @property
    def missing(self) -> int:
        """How many samples the gaps have swallowed."""
        return int(np.sum(np.rint(np.diff(self.gaps, axis=1) / self.period) - 1)) if len(self.gaps) else 0

    @property
    def note(self) -> str:
        """What is missing, as half a sentence; empty if nothing is."""
        if not len(self.gaps):
            return ""
        lengths = self.gaps[:, 1] - self.gaps[:, 0]
        longest = int(np.argmax(lengths))
        lost = f"{self.missing} sample{'s' if self.missing > 1 else ''} missing"
        if len(self.gaps) == 1:
            return f"{lost} in a gap of {lengths[0]:.4g} s at {self.gaps[0, 0]:.6g} s"
        where = f"the longest {lengths[longest]:.4g} s at {self.gaps[longest, 0]:.6g} s"
        return f"{lost} in {len(self.gaps)} gaps, {where}"


def sampling(t: NDArray[np.float64]) -> Sampling:
    """How the strictly ascending times t (n,), n >= 2, in s, are spaced."""
    intervals = np.diff(t)
    period = float(np.median(intervals))
    regular = bool(np.mean(np.abs(intervals - period) <= 0.5 * period) >= REGULAR)
    # round-off of large stamps must not decide
    wide = np.flatnonzero(intervals > LONGEST * period * (1.0 + 1e-6)) if regular else np.empty(0, dtype=int)
    return Sampling(period, regular, np.stack([t[wide], t[wide + 1]], axis=1))


def in_gap(t: NDArray[np.float64], gaps: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which of the times t (n,) lie strictly inside one of the `gaps` (k, 2), which are in order."""
    if not len(gaps):
        return np.zeros(len(t), dtype=bool)
    last = np.searchsorted(gaps[:, 0], t, side="left") - 1
    return (last >= 0) & (t < gaps[np.maximum(last, 0), 1])
