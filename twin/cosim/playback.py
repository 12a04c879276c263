"""A component stepped over inputs that are all there already: the same step as in a run, without a system around it."""

import numpy as np
from numpy.typing import NDArray

from twin.compiled.function import njit
from twin.cosim.component import Component
from twin.cosim.native import call_step
from twin.cosim.port import by_port, width


@njit(cache=True)
def _play(step, self, t, h, u_address, u_bytes, steps, y, y_address, rows):
    """`rows[k]` becomes the outputs after `steps[k]` more steps; (rows done, status), status 0 if all went well."""
    j = 0
    for k in range(len(rows)):
        for _ in range(steps[k]):
            status = call_step(step, self, t[j], h[j], u_address + j * u_bytes, y_address)
            if status != 0 and status != 1:
                return k, status
            j += 1
        rows[k] = y
    return len(rows), 0


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
    rows = np.empty((len(steps), width(component.outputs)))
    done, status = _play(
        component.step_address, component.self_address, t, h, u.ctypes.data, u.strides[0], steps, y, y.ctypes.data, rows
    )
    return rows[:done], status


def columns(component: Component, rows: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """`rows` (n, outputs) by port: (n,), or (n, size) of a port of several."""
    parts = by_port(component.outputs, rows)
    return {name: part[:, 0] if part.shape[1] == 1 else part for name, part in parts.items()}
