"""When a fault is active, in whole ticks that its component counts itself."""

from typing import NamedTuple

from twin.compiled.function import njit
from twin.cosim.port import Port
from twin.cosim.record import record

WINDOW = record(next="i8", period="i8", onset="i8", end="i8")
"""The tick of the next step, ticks between steps, and the fault's first and first healthy tick."""

ACTIVE = Port("active", 1, "1", "whether the fault is active", "bool")


class Span(NamedTuple):
    """The ticks onset <= k < end in which a fault is active; of a continuous component, steps that begin at these."""

    onset: int
    end: int


def window(span: Span, period: int) -> tuple[int, int, int, int]:
    """A `WINDOW` before the first step of a component of `period` ticks."""
    return 0, period, span.onset, span.end


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
