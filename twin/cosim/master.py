"""The master: one compiled loop over integer ticks.

At tick k: (1) sampled components that are due are evaluated at t_k from outputs valid at t_k; (2) the row of t_k is
written; (3) continuous components that are due go from t_k to t_k + h, and what is valid at t_(k+1) is published.

Outputs stand twice in `y`: the first half holds what is valid at the present tick, the second half the newest result
of each continuous component, which may belong to a later tick. Gauss-Seidel and Jacobi differ only in which half a
wire reads, so the coupling scheme is data (see `system.py`).
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from twin.cosim.component import NOT_FINITE
from twin.cosim.native import call_step, clock_cycles


class Table(NamedTuple):
    """What the loop knows of the components, one entry each, sampled ones first (all int64)."""

    step: np.ndarray
    self: np.ndarray
    period: np.ndarray
    u_start: np.ndarray
    u_size: np.ndarray
    y_start: np.ndarray
    y_size: np.ndarray


@njit(cache=True, inline="always")
def _step(table, wires, u, y, c, y_start, t, dt):
    for j in range(table.u_start[c], table.u_start[c] + table.u_size[c]):
        u[j] = y[wires[j]]
    status = call_step(
        table.step[c], table.self[c], t, table.period[c] * dt,
        u.ctypes.data + 8 * table.u_start[c], y.ctypes.data + 8 * y_start,
    )  # fmt: skip
    if status != 0 and status != 1:
        return status
    for j in range(y_start, y_start + table.y_size[c]):
        if not np.isfinite(y[j]):
            return NOT_FINITE
    return 0


@njit(cache=True, nogil=True)
def advance(table, wires, sampled, dt, u, y, rows, first, count, last, cycles):
    """Run ticks `first` to `first + count - 1`, at most to `last`; tick `last` gets a row but no step.

    Args:
        table: the components, the first `sampled` of them sampled.
        wires: (number of inputs,) index into `y` that feeds each input.
        dt: tick (s).
        u, y: inputs (n,), outputs (2 m,): valid half, newest half.
        rows: (>= count, m), filled with the valid half of each tick.
        cycles: (number of components,) processor cycles spent are added; empty: not measured.

    Returns:
        (rows written, component, status): component -1 if all went well, else the one whose step at tick
        `first + rows written - 1` (continuous) or `first + rows written` (sampled) failed.
    """
    half = y.shape[0] // 2
    for k in range(first, min(first + count, last + 1)):
        t = k * dt
        for c in range(sampled):
            if k % table.period[c] == 0:
                began = clock_cycles() if cycles.shape[0] else 0
                status = _step(table, wires, u, y, c, table.y_start[c], t, dt)
                if cycles.shape[0]:
                    cycles[c] += clock_cycles() - began
                if status != 0:
                    return k - first, c, status
        rows[k - first, :] = y[:half]
        if k == last:
            return k - first + 1, -1, 0
        for c in range(sampled, table.step.shape[0]):
            if k % table.period[c] == 0:
                began = clock_cycles() if cycles.shape[0] else 0
                status = _step(table, wires, u, y, c, half + table.y_start[c], t, dt)
                if cycles.shape[0]:
                    cycles[c] += clock_cycles() - began
                if status != 0:
                    return k - first + 1, c, status
        for c in range(sampled, table.step.shape[0]):
            if (k + 1) % table.period[c] == 0:
                for j in range(table.y_start[c], table.y_start[c] + table.y_size[c]):
                    y[j] = y[half + j]
    return min(count, last + 1 - first), -1, 0
