"""A component stepped over inputs that are all there already: the same step as in a run, without a system around it."""

import numpy as np
from numpy.typing import NDArray

from twin.kernel.compiled.memory import copy
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.component import Component
from twin.kernel.cosim.native import call_step
from twin.kernel.cosim.port import by_port, width


@entry("int", "int", "int", "doubles", "doubles", "int", "int", "integers", "int", "int", "int", "int", "integers")
def _play(step, self, t, h, u_address, u_bytes, steps, count, y_address, rows_address, row_bytes, failed):
    """Row k becomes the outputs after `steps[k]` more steps; rows done, all of `count` unless a step `failed`."""
    j = 0
    for k in range(count):
        for _ in range(steps[k]):
            status = call_step(step, self, t[j], h[j], u_address + j * u_bytes, y_address)
            if status != 0 and status != 1:
                failed[0] = status
                return k
            j += 1
        copy(rows_address + k * row_bytes, y_address, row_bytes)
    return count


def play(
    component: Component,
    t: NDArray[np.float64],
    h: NDArray[np.float64],
    u: NDArray[np.float64],
    steps: NDArray[np.int64] | None = None,
) -> tuple[NDArray[np.float64], int]:
    """Step `component` from where it stands, once per row of `u`.

    Args:
        component: its memory is changed.
        t, h: time and length of each step (m,), s.
        u: its inputs at each step (m, inputs).
        steps: after how many steps each row of outputs is taken (n,), m in all; None: after each.

    Returns:
        Outputs (rows, outputs), fewer than asked for if a step failed, and the status of that step, else 0. What a
        step leaves unwritten keeps its value, as in a run.
    """
    steps = np.ones(len(u), dtype=np.int64) if steps is None else steps
    u = np.ascontiguousarray(u, dtype=np.float64)
    y = component.initial_outputs.copy()
    rows, status = np.empty((len(steps), width(component.outputs))), np.zeros(1, dtype=np.int64)
    done = _play(
        component.step_address, component.self_address, np.ascontiguousarray(t, dtype=float),
        np.ascontiguousarray(h, dtype=float), u.ctypes.data, u.strides[0], np.ascontiguousarray(steps, dtype=np.int64),
        len(rows), y.ctypes.data, rows.ctypes.data, rows.strides[0], status,
    )  # fmt: skip
    return rows[:done], int(status[0])


def columns(component: Component, rows: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """`rows` (n, outputs) by port: (n,), or (n, size) of a port of several."""
    parts = by_port(component.outputs, rows)
    return {name: part[:, 0] if part.shape[1] == 1 else part for name, part in parts.items()}
