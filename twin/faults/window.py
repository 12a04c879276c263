"""When a fault is active, in whole ticks that its component counts itself."""

import numpy as np
from numba import njit

from twin.cosim.port import Port
from twin.faults.fault import Fault

WINDOW = np.dtype([("next", "i8"), ("period", "i8"), ("onset", "i8"), ("end", "i8")], align=True)
"""The tick of the next step, ticks between steps, and the fault's first and first healthy tick."""

ACTIVE = Port("active", 1, "1", "whether the fault is active", "bool")


def window(fault: Fault, period: int) -> tuple[int, int, int, int]:
    """A `WINDOW` before the first step of a component of `period` ticks."""
    return 0, period, fault.onset, fault.end


@njit(cache=True)
def tick_now(window):
    """The tick of the present step; called once per step, because it counts them."""
    k = window.next
    window.next = k + window.period
    return k


@njit(cache=True)
def within(window, k):
    """Whether the fault is active at tick `k`."""
    return window.onset <= k and k < window.end
