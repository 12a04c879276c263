"""A component without inputs, whose outputs are functions of time: expressions, and samples held or joined by lines."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from twin.kernel.compiled.function import carray, njit, pointer_to
from twin.kernel.cosim.component import NativeComponent, doubles_at, step_function
from twin.kernel.cosim.expression import Expression, begun, evaluated
from twin.kernel.cosim.port import Port, record

CHANNEL = record(kind="i8", first="i8", second="i8", size="i8", stack="i8")
"""Addresses of an output's operations, numbers and stack, or of its times and values; and how many."""
MEMORY = record(channels="i8", width="i8")
EXPRESSION, LINES, HELD = range(3)
_channels_at = pointer_to(CHANNEL)


Between = Literal["lines", "held"]


@dataclass(frozen=True)
class SampledSignal:
    """Values over time.

    Attributes:
        t: times (s), which do not descend, (n,); where one comes twice the value jumps.
        values: (n,).
        between: "lines", or "held": each until the next. Before the first one and after the last one these hold.
    """

    t: np.ndarray
    values: np.ndarray
    between: Between

    def at(self, t: float) -> float:
        """The value at `t` (s)."""
        times, values = (np.ascontiguousarray(one, dtype=float) for one in (self.t, self.values))
        return float(_sampled(times, values, self.between == "lines", float(t)))


Signal = Expression | SampledSignal


@njit(cache=True, error_model="numpy")
def _sampled(times, values, lines, t):
    low, high = 0, len(times)
    # the last sample that has begun
    while low < high:
        middle = (low + high) // 2
        if begun(t, times[middle]):
            low = middle + 1
        else:
            high = middle
    last = low - 1
    if last < 0:
        return values[0]
    if not lines or last + 1 == len(times) or begun(times[last], t):
        return values[last]
    share = (t - times[last]) / (times[last + 1] - times[last])
    return values[last] + share * (values[last + 1] - values[last])


@step_function(MEMORY)
def step(m, t, h, u, y):
    channels, out = carray(_channels_at(m.channels), m.width), carray(y, m.width)
    for j in range(m.width):
        c = channels[j]
        if c.kind == EXPRESSION:
            out[j] = evaluated(c.first, c.second, c.size, c.stack, t)
        else:
            times, values = carray(doubles_at(c.first), c.size), carray(doubles_at(c.second), c.size)
            out[j] = _sampled(times, values, c.kind == LINES, t)
    return 0


def source(name: str, ports: Sequence[Port], signals: Sequence[Signal], start: float = 0.0) -> NativeComponent:
    """A sampled component that at each tick gives the value that each of `signals` has then.

    Args:
        name: of the component.
        ports: its outputs, one value each.
        signals: of each.
        start: when the run begins (s).
    """
    channels, keep = np.zeros(len(signals), dtype=CHANNEL), []
    for channel, signal in zip(channels, signals, strict=True):
        if isinstance(signal, Expression):
            parts = [signal.operations, signal.numbers, np.empty(signal.depth)]
            channel["kind"], channel["stack"] = EXPRESSION, parts[2].ctypes.data
        else:
            parts = [np.ascontiguousarray(one, dtype=float) for one in (signal.t, signal.values)]
            channel["kind"] = LINES if signal.between == "lines" else HELD
        channel["first"], channel["second"], channel["size"] = *(one.ctypes.data for one in parts[:2]), len(parts[0])
        keep += parts
    memory = np.array([(channels.ctypes.data, len(signals))], dtype=MEMORY)
    initial = np.array([signal.at(start) for signal in signals])
    # nothing of it changes, so its state goes anywhere
    return NativeComponent(name, (), tuple(ports), True, step, memory, initial, keep=(channels, keep))
