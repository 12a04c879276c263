"""The master: one compiled loop over integer ticks.

At tick k: (1) sampled components that are due are evaluated at t_k from outputs valid at t_k; (2) the row of t_k is
written; (3) continuous components that are due go from t_k to t_k + h, and what is valid at t_(k+1) is published.

Outputs stand twice in `y`: first what is valid at the present tick, then the newest result of each continuous
component, which may belong to a later tick. Gauss-Seidel and Jacobi differ only in which of the two a wire reads, so
the coupling scheme is data (see `system.py`). Where inputs are interpolated, a third copy holds what was valid before
the last publication, and an input is a weighted sum of the three; where steps are repeated, continuous components
go back and forth again with the weights of a tick whose end is known.
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
        ("weights", "i8"),
        ("u", "i8"),
        ("u_size", "i8"),
        ("valid", "i8"),
        ("newest", "i8"),
        ("before", "i8"),
        ("y_size", "i8"),
        ("finite", "i8"),
        ("cycles", "i8"),
        ("save", "i8"),
        ("restore", "i8"),
        ("rewind", "i8"),
    ],
    align=True,
)
"""What the loop knows of a component: addresses of its step, its memory, the indices into `y` that feed it, its inputs
and the copies of its outputs (a sampled component has only the valid one); period in ticks; number of inputs and
outputs; whether outputs have to be finite; processor cycles spent in it.

Addresses that may be 0: `weights` (2, inputs, 3) of what is valid, newest and before, in the first and in a repeated
step, where inputs are interpolated, and `before`; `save`, `restore` and the memory `rewind` that both work on.

Addresses, because asking an array for its own costs an atomic reference count, in every step of every component.
"""


@njit(cache=True, inline="always")
def _due(part, k):
    # a division costs more than the step of a small drive
    return part.period == 1 or k % part.period == 0


@njit(cache=True, inline="always")
def _step(part, timed, y, t, dt, width, again):
    began = clock_cycles() if timed else 0
    u = carray(doubles_at(part.u), part.u_size)
    sources = carray(integers_at(part.sources), part.u_size)
    if part.weights == 0:
        for j in range(part.u_size):
            u[j] = y[sources[j]]
    else:
        weights = carray(doubles_at(part.weights), (2, part.u_size, 3))[again]
        for j in range(part.u_size):
            i = sources[j]
            u[j] = weights[j, 0] * y[i] + weights[j, 1] * y[width + i] + weights[j, 2] * y[2 * width + i]
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
    if part.before != 0:
        before = carray(doubles_at(part.before), part.y_size)
        for j in range(part.y_size):
            before[j] = valid[j]
    for j in range(part.y_size):
        valid[j] = newest[j]


@njit(cache=True, inline="always")
def _call_all(table, sampled, functions, k, mark):
    """Call one function of every continuous component; returns (component, status) of the first that fails, or -1."""
    for c in range(sampled, table.shape[0]):
        mark[0], mark[1] = k, c
        status = call_step(functions[c], table[c].rewind, 0.0, 0.0, 0, 0)
        if status != 0:
            return c, status
    return -1, 0


@njit(cache=True, nogil=True)
def advance(table, sampled, timed, dt, y, width, iterations, rows, first, count, last, mark):
    """Run ticks `first` to `first + count - 1`, at most to `last`; tick `last` gets a row but no step.

    Args:
        table: (number of components,) of `TABLE`, the first `sampled` of them sampled.
        timed: whether to count cycles.
        dt: tick (s).
        y: all outputs, two or three times.
        width: how many they are.
        iterations: how often the continuous components make each step, 1 or more.
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
                status = _step(part, timed, y, t, dt, width, 0)
                if status != 0:
                    return k - first, c, status
        for j in range(rows.shape[1]):
            rows[k - first, j] = y[j]
        if k == last:
            return k - first + 1, -1, 0
        if iterations > 1:
            c, status = _call_all(table, sampled, table["save"], k, mark)
            if c >= 0:
                return k - first + 1, c, status
        for n in range(iterations):
            if n > 0:
                c, status = _call_all(table, sampled, table["restore"], k, mark)
                if c >= 0:
                    return k - first + 1, c, status
            for c in range(sampled, components):
                part = table[c]
                if _due(part, k):
                    mark[0], mark[1] = k, c
                    status = _step(part, timed, y, t, dt, width, min(n, 1))
                    if status != 0:
                        return k - first + 1, c, status
        for c in range(sampled, components):
            part = table[c]
            if _due(part, k + 1):
                _publish(part)
    return min(count, last + 1 - first), -1, 0
