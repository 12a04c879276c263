"""Observed order of an error in the tick."""

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

MAX_SLOPE_SPREAD = 0.3
"""Maximum spread of the slopes of neighbouring pairs for a power law."""
MIN_ERRORS = 3
"""Minimum number of errors above the floor for a slope that can be checked."""
MIN_SLOPE = 0.5
"""Minimum slope of an order: a smaller one is not due to the coupling."""


class OrderFinding(StrEnum):
    """Reliability of an observed order of convergence."""

    SMOOTH = "smooth"
    NOT_SMOOTH = "not smooth"
    NOT_FALLING = "does not fall with the tick"
    AT_FLOOR = "at the reference's own accuracy"
    UNSTABLE = "not stable at every tick"


@dataclass(frozen=True)
class Order:
    """Observed order of convergence p in error = C tick^p; if meaningless, `slope` is None, `finding` the reason."""

    slope: float | None
    finding: OrderFinding


def observed_order(ticks: ArrayLike, errors: ArrayLike, floor: float) -> Order:
    """Fit the order of convergence by least squares in log-log over the errors that the coupling causes.

    Args:
        ticks: s, (n,).
        errors: >= 0, infinite for a failed run, (n,).
        floor: accuracy of the reference; errors up to ten times this are left out.
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
