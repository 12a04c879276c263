"""Macro steps of varying length: step doubling, where every component can be set back.

Two steps of n ticks are made, and one of 2 n from the same state. Inputs are lines over a step, known at its end where
the source goes before, else drawn on, and held at the value of the middle of what a component makes in one go: the
midpoint rule, of order 2. The results of both then differ by 3 times the error of the two (Richardson 1911;
Hairer, Noersett, Wanner, "Solving Ordinary Differential Equations I", II.4)

    error = |y_2n - y_n,n| / (2^2 - 1)

which is to stay below its share of the tolerance, 2 n of all ticks of the run: the sum of all is then below it. The
last tick of a step is made apart, with inputs of the step's end, so that outputs that depend on them at once belong
there, too; inputs of the rest are such that the middle is kept. The error of such outputs does not add up in them, and
is to stay below the tolerance. A component that takes lines is given them, and makes its step in one go.

A row is written for every tick, on the line between two steps' ends, whose error |y_0 - 2 y_n + y_2n| / 8 is to stay
below the tolerance, too. Errors are measured by the largest value of each output so far, or its nominal one.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from twin.kernel.compiled.function import carray, copy, njit, pointer_to
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.component import (
    NOT_FINITE,
    NativeComponent,
    call_step,
    clock_cycles,
    doubles_at,
    integers_at,
    outcome,
    step_function,
)
from twin.kernel.cosim.master import LOOP, NO_COMPONENT, TABLE
from twin.kernel.cosim.port import Port, memory_of, record

if TYPE_CHECKING:
    from twin.kernel.cosim.system import System

CONTROL = record(
    loop="i8",  # a `master.LOOP`
    tolerance="f8",
    first="i8",  # tick of the run
    n="i8",  # ticks that are tried next
    lately="i8",  # ticks of the step before
    made="i8",  # tick at which all components stand
    ticks="i8",  # of the ends of the last steps, (3,)
    points="i8",  # outputs there, (3, outputs)
    saved="i8",  # outputs valid now and before, and of the long step, (3, outputs)
    scale="i8",  # of each output; 0: it is no number that lies on a line
    own="i8",  # column of the outputs of `StepControl`
    u="i8",  # all inputs
    direct="i8",  # of each output, whether it depends on inputs at once
    lines="i8",  # of each component, whether it takes lines
    how="i8",  # of each input, `HELD` or one of the next
    error="f8",  # of the last two steps
    total="f8",  # of all
    steps="i8",  # that counted
    rejected="i8",
    loose="i8",  # pairs of single ticks that miss their share
)
"""Addresses and numbers of what the loop works on."""

OUTPUTS = (
    Port("step", 1, "s", "length of the step that ended last"),
    Port("error", 1, "1", "estimated error of the last two steps, of the largest value or the nominal one"),
    Port("error_total", 1, "1", "sum of these since the start, to be below the tolerance"),
)
HELD, HELD_NEWEST, TO_NEWEST, DRAWN_ON, DRAWN_TO_END = range(5)
"""What an input is over a step: its value at the start or the newest one, on the line from one to the other, on the
line of the step before, or the end of that."""
NAME = "master"
"""Of the component that has them."""
ORDER = 2
MOST_GROWTH, LEAST_GROWTH, CAUTION = 2.0, 0.2, 0.9
SHORTEST, MOST_TICKS = 2, 1 << 20
"""Ticks of a step."""
FATAL = 4

_parts_at, _loop_at, _control_at = pointer_to(TABLE), pointer_to(LOOP), pointer_to(CONTROL)


@step_function(record(nothing="i8"), (), OUTPUTS)
def _never(m, t, h, u, y):
    """The loop writes its outputs."""
    return 0


class StepControl(NativeComponent):
    """Whose outputs tell of the steps; it has no state, as what has been tried cannot be saved."""

    def __init__(self) -> None:
        super().__init__(NAME, (), OUTPUTS, True, _never, memory_of(record(nothing="i8")))

    def lacks_state(self, portable: bool = True) -> str:
        return "steps by what it has found out on the way, which is not saved"


@njit(cache=True)
def _input(m, a, part, j, where, length):
    """The value of an input at a fraction of a step of so many ticks."""
    y = carray(doubles_at(m.y), 3 * m.width)
    i = carray(integers_at(part.sources), part.u_size)[j]
    how = carray(integers_at(a.how + part.u - a.u), part.u_size)[j]
    valid, newest = y[i], y[m.width + i]
    if how == HELD or (how >= DRAWN_ON and a.lately == 0):
        return valid
    if how == HELD_NEWEST:
        return newest
    if how == TO_NEWEST:
        return valid + where * (newest - valid)
    if how == DRAWN_TO_END:
        where = 1.0
    return valid + where * length / a.lately * (valid - y[2 * m.width + i])


@njit(cache=True)
def _part_of_step(m, a, part, k, begin, end, length, where):
    """Step a component from tick `k` + `begin` to `k` + `end` of a step of so many ticks; 0, or a bad status.

    Args:
        where: in the step, a fraction, its inputs are taken.
    """
    u = carray(doubles_at(part.u), part.u_size)
    for j in range(part.u_size):
        u[j] = _input(m, a, part, j, where, length)
    began = clock_cycles() if m.timed != 0 else 0
    status = call_step(part.step, part.self, (k + begin) * m.dt, (end - begin) * m.dt, part.u, part.newest)
    if m.timed != 0:
        part.cycles += clock_cycles() - began
    return status


@njit(cache=True)
def _stepped(m, a, k, length):
    """Step all components from tick `k`; False: one failed, who and how is noted."""
    parts, mark = carray(_parts_at(m.table), m.components), carray(integers_at(m.mark), 2)
    takes_lines = carray(integers_at(a.lines), m.components)
    mark[0] = k
    for c in range(m.sampled, m.components):
        mark[1] = c
        part = parts[c]
        status = 0
        lines = takes_lines[c] != 0
        if length > 1 and not lines:
            # together with the end's in the last tick as much as the middle's in all of them
            status = _part_of_step(m, a, part, k, 0, length - 1, length, (0.5 * length - 1.0) / (length - 1))
        if status == 0 or status == 1:
            begin, where = (0, 0.5) if lines else (length - 1, 1.0)
            status = _part_of_step(m, a, part, k, begin, length, length, where)
        status = outcome(status, part.newest, part)
        if status != 0:
            m.culprit, m.status = c, status
            return False
    return True


@njit(cache=True)
def _all(m, back):
    """Save the state of all components, or go back to it; False: one refuses, who and how is noted."""
    parts, mark = carray(_parts_at(m.table), m.components), carray(integers_at(m.mark), 2)
    for c in range(m.sampled, m.components):
        mark[1] = c
        status = call_step(parts[c].restore if back else parts[c].save, parts[c].rewind, 0.0, 0.0, 0, 0)
        if status != 0:
            m.culprit, m.status = c, status
            return False
    return True


@njit(cache=True)
def _publish(m, a, length):
    """What is newest is valid now; of `StepControl` nothing is."""
    size = 8 * m.width
    own = carray(doubles_at(m.y), m.width)[a.own : a.own + 3]
    step, error, total = own[0], own[1], own[2]
    copy(m.y + 2 * size, m.y, size)
    copy(m.y, m.y + size, size)
    own[0], own[1], own[2] = step, error, total
    a.lately = length


@njit(cache=True, error_model="numpy")
def _compared(m, a, ticks):
    """(error over its share, error) of two steps, which cover so many `ticks`, by the long one."""
    width, y = m.width, carray(doubles_at(m.y), 3 * m.width)
    saved, points = carray(doubles_at(a.saved), (3, width)), carray(doubles_at(a.points), (3, width))
    scale, direct = carray(doubles_at(a.scale), width), carray(integers_at(a.direct), width)
    share, worst, largest = a.tolerance * ticks / (m.last - a.first), 0.0, 0.0
    for i in range(width):
        if scale[i] > 0.0:
            newest = y[width + i]
            size = max(scale[i], abs(newest))
            error = abs(saved[2, i] - newest) / (size * (2**ORDER - 1))
            bend = abs(points[0, i] - 2.0 * y[i] + newest) / (8.0 * size)
            # a bend grows with the square of the step, as an error does beside its share
            worst = max(worst, bend / a.tolerance)
            if direct[i] != 0:
                worst = max(worst, error / a.tolerance)
            else:
                worst, largest = max(worst, error / share), max(largest, error)
    return worst, largest


@njit(cache=True)
def _accepted(m, a, error):
    """Steps are made: their end is noted, and what was found out on the way."""
    width, y = m.width, carray(doubles_at(m.y), 3 * m.width)
    points, scale = carray(doubles_at(a.points), (3, width)), carray(doubles_at(a.scale), width)
    a.error = error
    a.total += error
    y[a.own], y[a.own + 1], y[a.own + 2] = a.lately * m.dt, error, a.total
    for i in range(width):
        points[2, i] = y[i]
        if scale[i] > 0.0:
            scale[i] = max(scale[i], abs(y[i]))


@njit(cache=True)
def _fatal(m):
    """Whether the status that was noted is one after which nothing may be called."""
    return m.status < NOT_FINITE and m.status % 16 == FATAL


@njit(cache=True, error_model="numpy")
def _went_on(m, a):
    """Two steps from tick `a.made` on, as long as the tolerance allows; False: a component failed in the next tick."""
    width, size, k = m.width, 8 * m.width, a.made
    points, ticks = carray(doubles_at(a.points), (3, width)), carray(integers_at(a.ticks), 3)
    copy(a.points, m.y, size)
    copy(a.saved, m.y, size)
    copy(a.saved + size, m.y + 2 * size, size)
    lately = a.lately
    if not _all(m, False):
        return False
    n = min(a.n, (m.last - k) // 2)
    while n >= SHORTEST:
        fine = _stepped(m, a, k, 2 * n)
        if not fine and _fatal(m):
            return False
        if fine:
            copy(a.saved + 2 * size, m.y + size, size)
            if not _all(m, True):
                return False
            fine = _stepped(m, a, k, n)
        if fine:
            _publish(m, a, n)
            copy(a.points + size, m.y, size)
            fine = _stepped(m, a, k + n, n)
        worst = np.inf
        if fine:
            worst, error = _compared(m, a, 2 * n)
            if worst <= 1.0 or n <= SHORTEST:
                _publish(m, a, n)
                ticks[0], ticks[1], ticks[2] = k, k + n, k + 2 * n
                points[1, a.own], points[1, a.own + 1], points[1, a.own + 2] = n * m.dt, a.error, a.total
                _accepted(m, a, error)
                a.loose += 1 if worst > 1.0 else 0
                a.steps += 2
                a.made = k + 2 * n
                growth = CAUTION / np.sqrt(worst)
                a.n = max(SHORTEST, min(int(n * min(growth, MOST_GROWTH)), MOST_TICKS))
                return True
        elif _fatal(m):
            return False
        a.rejected += 2
        copy(m.y, a.saved, size)
        copy(m.y + 2 * size, a.saved + size, size)
        a.lately = lately
        if not _all(m, True):
            return False
        if not fine:
            m.culprit = NO_COMPONENT
            if n <= SHORTEST:
                break
        n = max(SHORTEST, min(int(n * max(LEAST_GROWTH, CAUTION / np.sqrt(worst))), n - 1))
    # one tick by itself: it is the last one, or a component fails in this one or the next
    if not _stepped(m, a, k, 1):
        return False
    _publish(m, a, 1)
    _accepted(m, a, 0.0)
    copy(a.points + size, a.points + 2 * size, size)
    ticks[0], ticks[1], ticks[2] = k, k + 1, k + 1
    a.steps += 1
    a.made, a.n = k + 1, SHORTEST
    return True


@njit(cache=True)
def _write(m, a, k, row):
    """The row of tick `k`, between the ends of the last steps."""
    width = m.width
    points, ticks = carray(doubles_at(a.points), (3, width)), carray(integers_at(a.ticks), 3)
    scale, out = carray(doubles_at(a.scale), width), carray(doubles_at(m.rows + 8 * m.row_width * row), width)
    if k >= ticks[2]:
        for i in range(width):
            out[i] = points[2, i]
        return
    n = 0 if k < ticks[1] else 1
    share = (k - ticks[n]) / (ticks[n + 1] - ticks[n])
    for i in range(width):
        out[i] = points[n, i]
        if scale[i] > 0.0:
            out[i] += share * (points[n + 1, i] - points[n, i])


@entry("int", "int", "int", "int", "int")
def advance(control, first, count, row):
    """As `master.advance`, with the address of a `CONTROL`."""
    a = carray(_control_at(control), 1)[0]
    m = carray(_loop_at(a.loop), 1)[0]
    m.culprit = NO_COMPONENT
    done = 0
    for k in range(first, min(first + count, m.last + 1)):
        if k > a.made and not _went_on(m, a):
            break
        _write(m, a, k, row + done)
        done += 1
    carray(integers_at(m.mark), 2)[1] = NO_COMPONENT
    return done if m.culprit < 0 else -1 - done


def _how(port: Port, moving: bool, seen: bool) -> int:
    if not moving:
        return HELD_NEWEST if seen else HELD
    if port.instant == "start":
        return HELD
    if port.instant == "end":
        return HELD_NEWEST if seen else DRAWN_TO_END
    return TO_NEWEST if seen else DRAWN_ON


class Control:
    """What steps a simulation of `system` in macro steps of varying length.

    Args:
        system: of continuous components that can repeat steps, and a `StepControl`.
        loop, y, u: its memory, as `System` makes it.
        tolerance: relative.
        nominal: of each output; 0: it is held between the ends of steps, and no error is looked for.
        direct: whether each output depends on inputs at once; its error is one of this instant, and adds up where
            another output tells of it.
        moves: whether each input may be something else than a value that an output had.

    Attributes:
        address, advance: what steps, and the memory that it is called with.
        memory: (1,) of `CONTROL`.
    """

    def __init__(
        self,
        system: "System",
        loop: np.ndarray,
        y: np.ndarray,
        u: np.ndarray,
        tolerance: float,
        nominal: Sequence[float],
        direct: Sequence[bool],
        moves: Sequence[bool],
    ):
        width = system.outputs_width
        owners = np.searchsorted(system.y_start, system.sources, side="right") - 1
        targets = np.searchsorted(system.u_start, np.arange(system.inputs_width), side="right") - 1
        ports = [port for component in system.components for port in component.inputs for _ in range(port.size)]
        how = [
            _how(port, moving, system.sees_newest(int(owner), int(target)))
            for port, owner, target, moving in zip(ports, owners, targets, moves, strict=True)
        ]
        lines = [any(port.instant == "end" for port in component.inputs) for component in system.components]
        self._lines = np.array(lines, dtype=np.uint64)
        self._how = np.array(how, dtype=np.uint64)
        self._direct = np.array(direct, dtype=np.uint64)
        self._points, self._saved = np.tile(y[:width], (3, 1)), np.zeros((3, width))
        own = system.columns(f"{NAME}.{OUTPUTS[0].name}").start
        self._scale = np.array(nominal, dtype=float)
        self._scale = np.where(self._scale > 0.0, np.maximum(self._scale, np.abs(y[:width])), 0.0)
        self._ticks = np.full(3, system.first_tick, dtype=np.uint64)
        self._parts = loop, y, u
        self.memory = memory_of(
            CONTROL,
            loop=loop.ctypes.data, tolerance=tolerance, first=system.first_tick, n=SHORTEST, made=system.first_tick,
            ticks=self._ticks.ctypes.data, points=self._points.ctypes.data, saved=self._saved.ctypes.data,
            scale=self._scale.ctypes.data, own=own, u=u.ctypes.data, direct=self._direct.ctypes.data,
            lines=self._lines.ctypes.data, how=self._how.ctypes.data,
        )  # fmt: skip
        self.address = self.memory.ctypes.data
        self.advance = advance.native.called

    @property
    def counts(self) -> dict[str, int]:
        """Steps that counted, those that were tried in vain, and pairs of single ticks that miss their share."""
        return {name: int(self.memory[name][0]) for name in ("steps", "rejected", "loose")}
