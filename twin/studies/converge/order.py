"""How fast an error falls with the tick."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

MAX_SLOPE_SPREAD = 0.3
"""Slopes of neighbouring pairs that differ by more belong to no power of the tick."""
MIN_ERRORS = 3
"""So many errors above the floor make a slope that can contradict itself."""
MIN_SLOPE = 0.5
"""A smaller slope is no order: what is left is not the coupling's error."""


class OrderFinding(StrEnum):
    """What can be said of an order."""

    SMOOTH = "smooth"
    NOT_SMOOTH = "not smooth"
    NOT_FALLING = "does not fall with the tick"
    AT_FLOOR = "at the reference's own accuracy"
    UNSTABLE = "not stable at every tick"


@dataclass(frozen=True)
class Order:
    """p in error = C tick^p; `slope` is None where it would mean nothing, and `finding` says why."""

    slope: float | None
    finding: OrderFinding


def observed_order(ticks: ArrayLike, errors: ArrayLike, floor: float) -> Order:
    """Least squares in log-log over the errors that say something of the coupling.

    Args:
        ticks: s, (n,).
        errors: >= 0, infinite where the run failed, (n,).
        floor: errors up to ten times this are left out: there the reference's own error is more than a tenth.
    """
    h, e = np.asarray(ticks, dtype=float), np.asarray(errors, dtype=float)
    if not np.all(np.isfinite(e)):
        return Order(None, OrderFinding.UNSTABLE)
    clear = e > 10.0 * floor
    if np.count_nonzero(clear) < MIN_ERRORS:
        return Order(None, OrderFinding.AT_FLOOR)
    by_tick = np.argsort(h[clear])
    log_h, log_e = np.log(h[clear][by_tick]), np.log(e[clear][by_tick])
    pairs = np.diff(log_e) / np.diff(log_h)
    slope = float(np.polyfit(log_h, log_e, 1)[0])
    if slope < MIN_SLOPE:
        return Order(None, OrderFinding.NOT_FALLING)
    return Order(slope, OrderFinding.NOT_SMOOTH if np.ptp(pairs) > MAX_SLOPE_SPREAD else OrderFinding.SMOOTH)
