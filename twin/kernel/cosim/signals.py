"""Playback: a component whose outputs are rows of a given array."""

import numpy as np

from twin.kernel.compiled.function import carray
from twin.kernel.cosim.component import Component, NativeComponent, doubles_at, step_function
from twin.kernel.cosim.port import Port, memory_of, record, state, width

PLAYBACK_MEMORY = record(rows="i8", count="i8", size="i8", next=state("i8"))


@step_function(PLAYBACK_MEMORY)
def step(m, t, h, u, y):
    rows, y_ = carray(doubles_at(m.rows), m.count * m.size), carray(y, m.size)
    row = min(m.next, m.count - 1)
    for j in range(m.size):
        y_[j] = rows[row * m.size + j]
    m.next += 1
    return 0


def playback(ports: tuple[Port, ...], values: np.ndarray) -> Component:
    """Make a component that outputs row k of `values` (ticks, width of `ports`) at tick k, the last row afterwards."""
    rows = np.ascontiguousarray(values, dtype=float).reshape(-1, width(ports))
    memory = memory_of(PLAYBACK_MEMORY, count=len(rows), size=rows.shape[1])
    return NativeComponent("signals", (), ports, True, step, memory, rows[0].copy(), pointers={"rows": rows})
