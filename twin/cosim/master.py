"""The master: one compiled loop over integer ticks.

At tick k: (1) sampled components that are due are evaluated at t_k from outputs valid at t_k; (2) the row of t_k is
written; (3) continuous components that are due go from t_k to t_k + h, and what is valid at t_(k+1) is published.

Outputs stand twice in `y`: the first half holds what is valid at the present tick, the second half the newest result
of each continuous component, which may belong to a later tick. Gauss-Seidel and Jacobi differ only in which half a
wire reads, so the coupling scheme is data (see `system.py`).
"""

import numpy as np
from numba import carray, njit

from twin.cosim.component import NOT_FINITE
from twin.cosim.native import call_step, clock_cycles, doubles_at, integers_at

TABLE = np.dtype(
    [
        ("step", "i8"),
        ("self", "i8"),
        ("period", "i8"),
        ("sources", "i8"),
        ("u", "i8"),
        ("u_size", "i8"),
        ("valid", "i8"),
        ("newest", "i8"),
        ("y_size", "i8"),
        ("finite", "i8"),
        ("cycles", "i8"),
    ],
    align=True,
)
"""What the loop knows of a component: addresses of its step, its memory, the indices into `y` that feed it, its inputs
and both halves of its outputs (a sampled component has only the valid one); period in ticks; number of inputs and
outputs; whether outputs have to be finite; processor cycles spent in it.

Addresses, because asking an array for its own costs an atomic reference count, in every step of every component.
"""


@njit(cache=True, inline="always")
def _due(part, k):
    # a division costs more than the step of a small drive
    return part.period == 1 or k % part.period == 0


@njit(cache=True, inline="always")
def _step(part, timed, y, t, dt):
    began = clock_cycles() if timed else 0
    u = carray(doubles_at(part.u), part.u_size)
    sources = carray(integers_at(part.sources), part.u_size)
    for j in range(part.u_size):
        u[j] = y[sources[j]]
    status = call_step(part.step, part.self, t, part.period * dt, part.u, part.newest)
    if timed:
        part.cycles += clock_cycles() - began
    if status != 0 and status != 1:
        return status
    newest = carray(doubles_at(part.newest), part.y_size)
    for j in range(part.y_size):
        # asked in this order, a component that may return NaN costs the others nothing
        if not np.isfinite(newest[j]) and part.finite:
            return NOT_FINITE
    return 0


@njit(cache=True, inline="always")
def _publish(part):
    valid, newest = carray(doubles_at(part.valid), part.y_size), carray(doubles_at(part.newest), part.y_size)
    for j in range(part.y_size):
        valid[j] = newest[j]


@njit(cache=True, nogil=True)
def advance(table, sampled, timed, dt, y, rows, first, count, last, mark):
    """Run ticks `first` to `first + count - 1`, at most to `last`; tick `last` gets a row but no step.

    Args:
        table: (number of components,) of `TABLE`, the first `sampled` of them sampled.
        timed: whether to count cycles.
        dt: tick (s).
        y: outputs (2 m,): valid half, newest half.
        rows: (>= count, m), filled with the valid half of each tick.
        mark: (2,) int64, set to tick and component before each step, for whoever watches from outside: a step that
            crashes or never returns can tell nobody.

    Returns:
        (rows written, component, status): component -1 if all went well, else the one whose step at tick
        `first + rows written - 1` (continuous) or `first + rows written` (sampled) failed.
    """
    components = table.shape[0]
    for k in range(first, min(first + count, last + 1)):
        t = k * dt
        for c in range(sampled):
            part = table[c]
            if _due(part, k):
                mark[0], mark[1] = k, c
                status = _step(part, timed, y, t, dt)
                if status != 0:
                    return k - first, c, status
        for j in range(rows.shape[1]):
            rows[k - first, j] = y[j]
        if k == last:
            return k - first + 1, -1, 0
        for c in range(sampled, components):
            part = table[c]
            if _due(part, k):
                mark[0], mark[1] = k, c
                status = _step(part, timed, y, t, dt)
                if status != 0:
                    return k - first + 1, c, status
        for c in range(sampled, components):
            part = table[c]
            if _due(part, k + 1):
                _publish(part)
    return min(count, last + 1 - first), -1, 0
