"""A component that plays back known signals."""

import numpy as np

from twin.kernel.compiled.function import carray
from twin.kernel.cosim.component import Component, doubles_at, step_function
from twin.kernel.cosim.port import Port, width

MEMORY = np.dtype([("rows", "i8"), ("count", "i8"), ("size", "i8"), ("next", "i8")], align=True)


@step_function(MEMORY)
def step(m, t, h, u, y):
    rows, y_ = carray(doubles_at(m.rows), m.count * m.size), carray(y, m.size)
    row = min(m.next, m.count - 1)
    for j in range(m.size):
        y_[j] = rows[row * m.size + j]
    m.next += 1
    return 0


def playback(ports: tuple[Port, ...], values: np.ndarray) -> Component:
    """Sampled component without inputs: at tick k its outputs are row k of `values`, after the last row that one.

    Args:
        values: (ticks, width of `ports`).
    """
    rows = np.ascontiguousarray(values, dtype=float).reshape(-1, width(ports))
    memory = np.array([(rows.ctypes.data, len(rows), rows.shape[1], 0)], dtype=MEMORY)
    return Component(
        name="signals",
        inputs=(),
        outputs=ports,
        sampled=True,
        step_address=step.address,
        self_address=memory.ctypes.data,
        initial_outputs=rows[0].copy(),
        keep=(memory, rows),
    )
