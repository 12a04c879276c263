"""How a quantity approaches what it should be."""

import numpy as np
from numpy.typing import NDArray

Curve = NDArray[np.float64]


def within(t: Curve, start: float, end: float) -> NDArray[np.bool_]:
    """Which samples lie in start <= t <= end (s), half a nanosecond of rounding allowed."""
    return (t >= start - 5e-10) & (t <= end + 5e-10)


def settling_time(t: Curve, y: Curve, target: float, band: float) -> float:
    """Time (s) from which |y - target| <= band holds to the end; infinity if it does not hold at the end.

    Args:
        t, y: samples (n,).
        target, band: in the unit of y.
    """
    outside = np.flatnonzero(np.abs(y - target) > band)
    if len(outside) == 0:
        return float(t[0])
    return float(t[outside[-1] + 1]) if outside[-1] + 1 < len(t) else np.inf


def first_time(t: Curve, condition: NDArray[np.bool_]) -> float:
    """Time (s) of the first sample at which `condition` holds; infinity if none."""
    hits = np.flatnonzero(condition)
    return float(t[hits[0]]) if len(hits) else np.inf


def overshoot(y: Curve, target: float) -> float:
    """By how much y exceeds a positive target at most, as a share of it; 0 if it never does."""
    return max(0.0, float(np.max(y)) / target - 1.0)


def rise_time(t: Curve, y: Curve, before: float, after: float) -> float:
    """Time (s) that y takes from 10 % to 90 % of the way from `before` to `after`; infinity if it never gets there."""
    share = (y - before) / (after - before)
    return first_time(t, share >= 0.9) - first_time(t, share >= 0.1)


def steepest_rise(t: Curve, y: Curve, span: float) -> float:
    """Largest mean rate of y over any `span` (s), in its unit per s; infinity if the samples do not span it.

    Args:
        t, y: evenly spaced samples (n,).
    """
    steps = round(span / (t[1] - t[0])) if len(t) > 1 else 0
    if not 0 < steps < len(t):
        return np.inf
    return float(np.max((y[steps:] - y[:-steps]) / (t[steps:] - t[:-steps])))
