"""The tolerance tube around a reference: where a value is right that may come a little early, late, high or low.

At time t the tube reaches from the smallest value that the reference takes in [t - dt, t + dt], less a tolerance, to
the largest, plus the tolerance; without the tolerance it is the reference's reach. The reference is the polygon through
its samples, so the ends of the window count with their interpolated values, and a copy of the reference shifted by no
more than dt lies inside whatever its slope.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Curve = NDArray[np.float64]


class Tube(NamedTuple):
    """Bounds at the times at which values are compared: lower and upper, (n,)."""

    lower: Curve
    upper: Curve

    def widened(self, tolerance: float) -> "Tube":
        """The tube with `tolerance` below and above."""
        return Tube(self.lower - tolerance, self.upper + tolerance)

    def excess(self, values: Curve) -> Curve:
        """How far values (n,) lie outside: positive above, negative below, 0 inside; infinite where not a number."""
        above, below = np.maximum(values - self.upper, 0.0), np.minimum(values - self.lower, 0.0)
        return np.where(np.isfinite(above + below), above + below, np.inf)


def reach(t: Curve, values: Curve, at: Curve, dt: float) -> Tube:
    """What the reference (t, values) takes within dt of the times `at`.

    Args:
        t, values: samples of the reference, (n,); t strictly ascending, s.
        at: times of comparison, (m,), ascending, s; within [t[0], t[-1]].
        dt: half width in time, s.
    """
    if dt == 0.0:
        middle = np.interp(at, t, values)
        return Tube(middle, middle)
    # beyond its ends the reference takes no values: the window is cut there
    left, right = np.maximum(at - dt, t[0]), np.minimum(at + dt, t[-1])
    ends = np.interp(np.stack([left, right]), t, values)
    first, last = np.searchsorted(t, left, side="left"), np.searchsorted(t, right, side="right")
    lower = np.minimum(ends.min(axis=0), _least(values, first, last))
    upper = np.maximum(ends.max(axis=0), -_least(-values, first, last))
    return Tube(lower, upper)


def _least(values: Curve, first: NDArray[np.intp], last: NDArray[np.intp]) -> Curve:
    """min(values[first[i]:last[i]]) for each i, infinity where that is empty.

    By a sparse table: level k holds the minima of all windows of 2^k samples, and two of them cover any window
    (Bender and Farach-Colton, The LCA problem revisited, 2000, section 3).
    """
    lengths = last - first
    least = np.full(len(first), np.inf)
    level, width = values, 1
    while width <= lengths.max(initial=0):
        chosen = (lengths >= width) & (lengths < 2 * width)
        least[chosen] = np.minimum(level[first[chosen]], level[last[chosen] - width])
        level = np.minimum(level[:-width], level[width:]) if len(level) > width else level
        width *= 2
    return least
