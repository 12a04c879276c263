"""Signal source: a component whose outputs are functions of time, from expressions or samples."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from twin.kernel.compiled.function import carray, njit, pointer_to
from twin.kernel.cosim.component import NativeComponent, doubles_at, step_function
from twin.kernel.cosim.expression import Expression, evaluate, has_begun
from twin.kernel.cosim.port import Port, record

CHANNEL_RECORD = record(kind="i8", first="i8", second="i8", size="i8", stack="i8")
"""Memory of an output: addresses of an expression's operations, numbers and stack, or of samples (t, values); count."""
SOURCE_MEMORY = record(channels="i8", width="i8")
EXPRESSION_CHANNEL, LINES_CHANNEL, HOLD_CHANNEL = range(3)
_channels_at = pointer_to(CHANNEL_RECORD)
Between = Literal["lines", "held"]


@dataclass(frozen=True)
class SampledSignal:
    """A signal given by samples (n,) at non-decreasing times (s); it jumps where a time occurs twice.

    Between samples it is linear ("lines"), or "held" until the next; the first and last value extend beyond them.
    """

    t: np.ndarray
    values: np.ndarray
    between: Between

    def value_at(self, t: float) -> float:
        """Return the value of the signal at time `t` (s)."""
        times, values = (np.ascontiguousarray(one, dtype=float) for one in (self.t, self.values))
        return float(_sample(times, values, self.between == "lines", float(t)))


Signal = Expression | SampledSignal


@njit(cache=True, error_model="numpy")
def _sample(times, values, lines, t):
    low, high = 0, len(times)
    # bisect for the last sample at or before t
    while low < high:
        middle = (low + high) // 2
        if has_begun(t, times[middle]):
            low = middle + 1
        else:
            high = middle
    last = low - 1
    if last < 0:
        return values[0]
    if not lines or last + 1 == len(times) or has_begun(times[last], t):
        return values[last]
    share = (t - times[last]) / (times[last + 1] - times[last])
    return values[last] + share * (values[last + 1] - values[last])


@step_function(SOURCE_MEMORY)
def step(m, t, h, u, y):
    channels, out = carray(_channels_at(m.channels), m.width), carray(y, m.width)
    for j in range(m.width):
        c = channels[j]
        if c.kind == EXPRESSION_CHANNEL:
            out[j] = evaluate(c.first, c.second, c.size, c.stack, t)
        else:
            times, values = carray(doubles_at(c.first), c.size), carray(doubles_at(c.second), c.size)
            out[j] = _sample(times, values, c.kind == LINES_CHANNEL, t)
    return 0


def source(name: str, ports: Sequence[Port], signals: Sequence[Signal]) -> NativeComponent:
    """Make a component that outputs the values of `signals` at every tick, each at one of the `ports` (of size 1)."""
    channels, keep = np.zeros(len(signals), dtype=CHANNEL_RECORD), []
    for channel, signal in zip(channels, signals, strict=True):
        if isinstance(signal, Expression):
            parts = [signal.operations, signal.numbers, np.empty(signal.depth)]
            channel["kind"], channel["stack"] = EXPRESSION_CHANNEL, parts[2].ctypes.data
        else:
            parts = [np.ascontiguousarray(one, dtype=float) for one in (signal.t, signal.values)]
            channel["kind"] = LINES_CHANNEL if signal.between == "lines" else HOLD_CHANNEL
        channel["first"], channel["second"], channel["size"] = *(one.ctypes.data for one in parts[:2]), len(parts[0])
        keep += parts
    memory = np.array([(channels.ctypes.data, len(signals))], dtype=SOURCE_MEMORY)
    initial = np.array([signal.value_at(0.0) for signal in signals])
    # the memory never changes, so the component has no state to save
    return NativeComponent(name, (), tuple(ports), True, step, memory, initial, keep=(channels, keep))
