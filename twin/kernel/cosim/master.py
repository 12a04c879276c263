"""The master algorithm: one compiled loop over integer ticks.

At tick k: (1) sampled components that are due are evaluated at t_k, from outputs valid at t_k; (2) the row of t_k is
written; (3) continuous components that are due step from t_k to t_k + h, and outputs valid at t_(k+1) are published.

The array `y` contains outputs twice: first the valid values of the present tick, then the newest result of each
continuous component, which may belong to a later tick. Gauss-Seidel and Jacobi differ only in which of the two a wire
reads, so the coupling scheme is data (see `system.py`). If no input reads a value that a newer result has replaced,
both are the same memory. If inputs are interpolated, a third copy contains the values valid before the last
publication, and an input is a weighted sum of the three. If steps are repeated, continuous components are restored and
step again, with the weights of a tick whose end is known.
"""

import numpy as np

from twin.kernel.compiled.function import carray, copy, njit, pointer_to
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.component import NOT_FINITE, call_step, clock_cycles, doubles_at, integers_at
from twin.kernel.cosim.port import record
from twin.kernel.settings import fields_of_form

COMPONENT_RECORD = record(
    **fields_of_form("i8", "step self period sources weights u u_size valid newest before y_size finite unread cycles"),
    **fields_of_form("i8", "save restore rewind"),
)
"""Component data of the loop. Addresses: step function, its memory, the indices into `y` of its inputs, its inputs, and
the copies of its outputs (only the valid one for a sampled component). Period (ticks), number of inputs and outputs,
whether outputs have to be finite, and the outputs that need not be (`Component.unread`; 0 without any). Processor
cycles spent in the component.

Addresses that may be 0: `weights` (2, inputs, 3) of the valid, newest and previous outputs, in the first and in a
repeated step, and `before`, both for interpolated inputs; `save`, `restore` and `rewind`, the memory of both.

Addresses are used as obtaining the address of an array costs an atomic reference count, in every step of every
component.
"""


NO_COMPONENT = -1
"""Component number in the mark between slices, when no component is stepping."""
LOOP_RECORD = record(
    **fields_of_form("i8", "table components sampled timed iterations apart"),
    dt="f8",
    **fields_of_form("i8", "y width rows row_width last mark culprit status"),
)
"""Memory of the loop: address of a `COMPONENT_RECORD` table, number of components, and number `sampled` of the sampled
ones, which come first; whether to count cycles; number of passes over each step of the continuous components, at least
1; whether newest outputs are separate from the valid ones; duration of a tick (s); address of all outputs (one to
three copies) and their number; address of the rows, and number of outputs written to each; the last tick, which gets a
row but no step; address of the mark, two integers set to tick and component before each step, for a supervisor
outside, as a step that crashes or never returns reports nothing itself.

Results: component -1 on success, else the component whose step failed, and its status.
"""

_parts_at, _loop_at = pointer_to(COMPONENT_RECORD), pointer_to(LOOP_RECORD)


@njit(cache=True, inline="always")
def _is_due(part, k):
    # a division costs more than the step of a small drive
    return part.period == 1 or k % part.period == 0


@njit(cache=True, inline="always")
def _step(part, timed, y, t, dt, width, again, held):
    began = clock_cycles() if timed else 0
    u = carray(doubles_at(part.u), part.u_size)
    sources = carray(integers_at(part.sources), part.u_size)
    if held or part.weights == 0:
        for j in range(part.u_size):
            u[j] = y[sources[j]]
    else:
        weights = carray(doubles_at(part.weights), (2, part.u_size, 3))[again]
        for j in range(part.u_size):
            i = sources[j]
            u[j] = weights[j, 0] * y[i] + weights[j, 1] * y[width + i] + weights[j, 2] * y[2 * width + i]
    status = call_step(part.step, (part.self, t, part.period * dt, part.u, part.newest))
    if timed:
        part.cycles += clock_cycles() - began
    if status != 0 and status != 1:
        return status
    newest = carray(doubles_at(part.newest), part.y_size)
    for j in range(part.y_size):
        # tested first, so that components without unread outputs do not pay for them
        if not np.isfinite(newest[j]) and part.finite:
            if part.unread == 0:
                return NOT_FINITE
            unread = carray(integers_at(part.unread), part.y_size)
            if unread[j] == 0:
                return NOT_FINITE
            if unread[j] == 1:
                unread[j] = 2 + np.uint64(t / dt + 0.5)
    return 0


@njit(cache=True, inline="always")
def _publish(part):
    if part.before != 0:
        copy(part.before, part.valid, 8 * part.y_size)
    copy(part.valid, part.newest, 8 * part.y_size)


@njit(cache=True, inline="always")
def _call_all(m, table, mark, restoring):
    """Save or restore every continuous component; return False, and set `status`, if one fails."""
    for c in range(m.sampled, m.components):
        mark[1] = c
        status = call_step(table[c].restore if restoring else table[c].save, (table[c].rewind, 0.0, 0.0, 0, 0))
        if status != 0:
            m.culprit, m.status = c, status
            return False
    return True


@njit(cache=True, inline="always")
def _step_continuous(m, table, mark, timed, y, k, again, apart):
    """Step every continuous component that is due; return False, and set `status`, if one fails.

    Unless newest outputs are `apart`, all components are due and inputs are held. It is a constant, so that the
    compiler removes the unused branch.
    """
    for c in range(np.uint64(m.sampled), np.uint64(m.components)):
        part = table[c]
        if not apart or _is_due(part, k):
            mark[1] = c
            status = _step(part, timed, y, k * m.dt, m.dt, m.width, again, not apart)
            if status != 0:
                m.culprit, m.status = c, status
                return False
    return True


@njit(cache=True)
def run_ticks(m, first, count, row):
    """Run ticks `first` to `first + count - 1` of a co-simulation, at most to the last tick; return the rows written.

    `m` is a `LOOP_RECORD`, `row` the index of the first row. If `m.culprit` is a component, its step failed at tick
    `first + rows written - 1` (continuous) or `first + rows written` (sampled).
    """
    table, mark = carray(_parts_at(m.table), m.components), carray(integers_at(m.mark), 2)
    y = carray(doubles_at(m.y), 3 * m.width)
    # unsigned: an index that cannot be negative saves a check
    sampled, components = np.uint64(m.sampled), np.uint64(m.components)
    width, dt, timed = m.width, m.dt, m.timed != 0
    m.culprit = -1
    for k in range(first, min(first + count, m.last + 1)):
        mark[0] = k
        for c in range(np.uint64(0), sampled):
            part = table[c]
            if _is_due(part, k):
                mark[1] = c
                status = _step(part, timed, y, k * dt, dt, width, 0, True)
                if status != 0:
                    m.culprit, m.status = c, status
                    return k - first
        copy(m.rows + 8 * m.row_width * (row + k - first), m.y, 8 * m.row_width)
        if k == m.last:
            return k - first + 1
        if not m.apart:
            if not _step_continuous(m, table, mark, timed, y, k, 0, False):
                return k - first + 1
            continue
        if m.iterations > 1 and not _call_all(m, table, mark, False):
            return k - first + 1
        for n in range(m.iterations):
            if n > 0 and not _call_all(m, table, mark, True):
                return k - first + 1
            if not _step_continuous(m, table, mark, timed, y, k, min(n, 1), True):
                return k - first + 1
        for c in range(sampled, components):
            part = table[c]
            if _is_due(part, k + 1):
                _publish(part)
    return min(count, m.last + 1 - first)


@entry("int", "int", "int", "int", "int")
def advance(loop, first, count, row):
    """Run ticks of the loop at address `loop`; return the rows written, or -1 - rows if a component failed.

    Passing only integers takes 0.2 us.
    """
    m = carray(_loop_at(loop), 1)[0]
    done = run_ticks(m, first, count, row)
    carray(integers_at(m.mark), 2)[1] = NO_COMPONENT
    return done if m.culprit < 0 else -1 - done
