"""A pure delay of whole ticks, for a computation or a bus that takes time."""

import numpy as np

from twin.kernel.compiled.function import carray
from twin.kernel.cosim.component import Component, NativeComponent
from twin.kernel.cosim.native import doubles_at, step_function
from twin.kernel.cosim.port import Port, width

MEMORY = np.dtype([("size", "i8"), ("ticks", "i8"), ("position", "i8"), ("ring", "i8")], align=True)


@step_function(MEMORY)
def step(m, t, h, u, y):
    ring = carray(doubles_at(m.ring), m.size * m.ticks)
    u_, y_ = carray(u, m.size), carray(y, m.size)
    start = m.position * m.size
    for j in range(m.size):
        y_[j] = ring[start + j]
        ring[start + j] = u_[j]
    m.position = (m.position + 1) % m.ticks
    return 0


@step_function(MEMORY)
def filled(m, t, h, u, y):
    """What a delay that is taken elsewhere does before its first step: its inputs have been as they are."""
    ring = carray(doubles_at(m.ring), m.size * m.ticks)
    u_, y_ = carray(u, m.size), carray(y, m.size)
    for j in range(m.size):
        y_[j] = u_[j]
        for tick in range(m.ticks):
            ring[tick * m.size + j] = u_[j]
    return 0


def delay(name: str, ports: tuple[Port, ...], ticks: int, initial: np.ndarray) -> Component:
    """Sampled component: its outputs `ports` are its inputs of `ticks` (>= 1) ticks ago, before that `initial`."""
    ring = np.tile(np.asarray(initial, dtype=float), (ticks, 1))
    memory = np.array([(width(ports), ticks, 0, 0)], dtype=MEMORY)
    return NativeComponent(name, ports, ports, True, step, memory, ring[0].copy(), pointers={"ring": ring})
