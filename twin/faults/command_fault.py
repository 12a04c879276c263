"""A drive that cannot run as fast as it is told: the command is limited on its last way into the drive.

When a fault is active, in whole ticks that its component counts itself.
"""

from collections.abc import Mapping
from typing import NamedTuple

from twin.compiled.function import carray, njit
from twin.cosim.component import NativeComponent
from twin.cosim.native import step_function
from twin.cosim.port import Port, memory_of, record

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


MEMORY = record(window=WINDOW, size="i8", limit="f8")


@step_function(MEMORY)
def step(m, t, h, u, y):
    asked, given = carray(u, m.size), carray(y, m.size + 1)
    active = within(m.window, tick_now(m.window))
    for j in range(m.size):
        given[j] = min(max(asked[j], -m.limit), m.limit) if active else asked[j]
    given[m.size] = active
    return 0


class FaultComponent(NativeComponent):
    """Something that breaks, between the wires of a healthy system.

    Attributes:
        numbers: of its [[fault]] that its memory has, not rounded to counts or ticks: by attribute the field, and how
            many times the number is there.
    """

    numbers: Mapping[str, tuple[str, float]] = {}


class CommandFault(FaultComponent):
    """Sampled component, every tick: commanded speeds in, the same within +-limit out while active.

    Args:
        name: of the component.
        span: when it is active.
        limit: of the drives' speed (rad/s).
        size: number of drives behind it.
    """

    def __init__(self, name: str, span: Span, limit: float, size: int):
        port = Port("omega_ref", size, "rad/s", "commanded motor speed, as far as the drive can follow")
        memory = memory_of(MEMORY, window=window(span, 1), size=size, limit=limit)
        super().__init__(name, (port,), (port, ACTIVE), True, step, memory)
