"""Solver of an algebraic loop: its members as one component, iterated until inputs and outputs agree.

The response of a member to other inputs is computed in one of two ways. A member with a reaction function (model
exchange) is evaluated at the end of its step. Any other member is restored and repeats the step, as co-simulation
defines no outputs for inputs that are set after a step. The unknowns z are the values fed back against the order of the
members. They have to equal g(z), the result of one pass over the members. Newton's method finds them,

    z <- z + M (g(z) - z),    M = (I - dg/dz)^-1

with dg/dz by finite differences when needed, and a correction after every pass (Broyden 1965, Mathematics of
Computation 19). Steps are shortened if the residual grows. M is kept from step to step.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from twin.kernel.compiled.function import carray, copy, njit, pointer_to
from twin.kernel.cosim.component import (
    NOT_FINITE,
    Component,
    Composite,
    address_of,
    call_step,
    doubles_at,
    integers_at,
    step_function,
    step_status,
)
from twin.kernel.cosim.port import Port, port_slices, record, state, width
from twin.kernel.errors import InputRefused
from twin.kernel.settings import fields_of_form

MEMBER_RECORD = record(
    step="i8",
    self="i8",
    react="i8",  # 0 if it repeats steps instead
    **fields_of_form("i8", "save restore rewind"),
    sources="i8",  # address of its indices into all values
    u="i8",
    u_size="i8",
    y="i8",  # address within all values
    y_size="i8",
    finite="i8",
)
LOOP_MEMORY = record(
    members="i8",
    count="i8",
    given="i8",  # number of inputs of the loop
    outputs="i8",  # number of outputs of its members
    size="i8",  # number of unknowns z
    values="i8",  # inputs, outputs, unknowns z
    led="i8",  # indices of the outputs g(z)
    inverse="i8",  # M
    scale="i8",  # largest magnitude of each unknown so far
    work="i8",  # see `_WORK_ROWS`
    known=state("i8"),  # whether M is known
    culprit="i8",
    status="i8",
    passes="i8",  # passes of the last step
    residual="f8",  # residual of the last pass
    correction="f8",  # remaining Newton correction of z
)
_WORK_ROWS = 6
"""Rows of scratch memory of the size of z: residual, previous residual, step, three more; the matrix follows them."""

MAX_RESIDUAL = 1e-8
"""Maximum relative residual, with respect to the largest value so far; FMUs with own solvers are not smoother."""
MAX_CORRECTION, MAX_GROWTH = 1e-4, 1e6
"""Maximum relative Newton correction that is omitted, and maximum growth of values over their first magnitude; beyond
these, a loop has no solution or many."""
MIN_SCALE = 1e-12
"""Scale of a value that has always been 0."""
DIFFERENCE_STEP = 1e-4
"""Relative change of a value in finite differences."""
MAX_PASSES, JACOBIAN_PASSES = 60, (8, 20, 40)
"""Maximum number of passes, and the passes at which dg/dz is computed again."""
MAX_LOOP_VALUES = 200
"""Maximum number of unknowns; each costs a pass to compute dg/dz."""
MEMBER_FAILED, NOT_CONVERGED = 2, 3

_members_at = pointer_to(MEMBER_RECORD)


@njit(cache=True)
def _gather(m, part):
    u = carray(doubles_at(part.u), part.u_size)
    sources = carray(integers_at(part.sources), part.u_size)
    values = carray(doubles_at(m.values), m.given + m.outputs + m.size)
    for j in range(part.u_size):
        u[j] = values[sources[j]]


@njit(cache=True)
def _check_member(m, c, part, status):
    """Whether a member of an algebraic loop stepped with finite outputs; if not, store the member and its status."""
    status = step_status(status, part.y, part)
    if status != 0:
        m.culprit, m.status = c, status
    return status == 0


@njit(cache=True)
def _run_pass(m, t, h):
    """Step all members of a loop once at the iterate z, store the residual g(z) - z; return whether all succeeded."""
    members = carray(_members_at(m.members), m.count)
    m.passes += 1
    for c in range(m.count):
        part = members[c]
        _gather(m, part)
        if part.react != 0:
            status = call_step(part.react, (part.self, t, h, part.u, part.y))
        else:
            status = call_step(part.restore, (part.rewind, 0.0, 0.0, 0, 0))
            if status == 0:
                status = call_step(part.step, (part.self, t, h, part.u, part.y))
        if not _check_member(m, c, part, status):
            return False
    values = carray(doubles_at(m.values), m.given + m.outputs + m.size)
    led, f = carray(integers_at(m.led), m.size), carray(doubles_at(m.work), m.size)
    z = values[m.given + m.outputs :]
    scale = carray(doubles_at(m.scale), m.size)
    m.residual = 0.0
    for i in range(m.size):
        f[i] = values[led[i]] - z[i]
        scale[i] = max(scale[i], abs(z[i]))
        m.residual = max(m.residual, abs(f[i]) / scale[i])
    return True


@njit(cache=True)
def _invert(a, inverse, n):
    """Invert the matrix `a` (n, n), which is overwritten; return False if it is singular."""
    for i in range(n):
        for j in range(n):
            inverse[i, j] = 1.0 if i == j else 0.0
    for column in range(n):
        pivot = column
        for i in range(column + 1, n):
            if abs(a[i, column]) > abs(a[pivot, column]):
                pivot = i
        if not abs(a[pivot, column]) > 0.0:
            return False
        for j in range(n):
            a[column, j], a[pivot, j] = a[pivot, j], a[column, j]
            inverse[column, j], inverse[pivot, j] = inverse[pivot, j], inverse[column, j]
        factor = a[column, column]
        for j in range(n):
            a[column, j] /= factor
            inverse[column, j] /= factor
        for i in range(n):
            factor = a[i, column]
            if i != column and factor != 0.0:
                for j in range(n):
                    a[i, j] -= factor * a[column, j]
                    inverse[i, j] -= factor * inverse[column, j]
    return True


@njit(cache=True)
def _differentiate(m, t, h):
    """Compute the inverse matrix M of an algebraic loop at the iterate z; return False if a member failed."""
    n = m.size
    work = carray(doubles_at(m.work), (_WORK_ROWS, n))
    matrix = carray(doubles_at(m.work + 8 * _WORK_ROWS * n), (n, n))
    inverse, scale = carray(doubles_at(m.inverse), (n, n)), carray(doubles_at(m.scale), n)
    z = carray(doubles_at(m.values), m.given + m.outputs + n)[m.given + m.outputs :]
    here = work[5]
    for i in range(n):
        here[i] = work[0, i]
    residual = m.residual
    for j in range(n):
        before, nudge = z[j], DIFFERENCE_STEP * max(scale[j], abs(here[j]))
        z[j] = before + nudge
        if not _run_pass(m, t, h):
            return False
        z[j] = before
        for i in range(n):
            # derivative of z - g(z)
            matrix[i, j] = (here[i] - work[0, i]) / nudge
    for i in range(n):
        work[0, i] = here[i]
    m.residual = residual
    if not _invert(matrix, inverse, n):
        # singular: the loop has no solution or many, but damped steps may still leave this point
        for i in range(n):
            for j in range(n):
                inverse[i, j] = 0.5 if i == j else 0.0
    m.known = 1
    return True


@njit(cache=True)
def _correct_inverse(m):
    """Update the loop's inverse matrix M by Broyden's formula from the last step and its change of the residual."""
    n = m.size
    work, inverse = carray(doubles_at(m.work), (_WORK_ROWS, n)), carray(doubles_at(m.inverse), (n, n))
    step, change, row = work[2], work[3], work[4]
    below = 0.0
    for i in range(n):
        change[i] = row[i] = 0.0
        for j in range(n):
            change[i] += inverse[i, j] * (work[1, j] - work[0, j])
            row[i] += step[j] * inverse[j, i]
        below += step[i] * change[i]
    if below != 0.0:
        for i in range(n):
            for j in range(n):
                inverse[i, j] += (step[i] - change[i]) * row[j] / below


@njit(cache=True)
def _solve(m, t, h):
    """Iterate an algebraic loop until its residual is small enough; return 0, MEMBER_FAILED or NOT_CONVERGED."""
    n = m.size
    work, inverse = carray(doubles_at(m.work), (_WORK_ROWS, n)), carray(doubles_at(m.inverse), (n, n))
    z = carray(doubles_at(m.values), m.given + m.outputs + n)[m.given + m.outputs :]
    scale = carray(doubles_at(m.scale), n)
    best, reach = np.inf, 0.0
    for number in range(MAX_PASSES):
        if not _run_pass(m, t, h):
            return MEMBER_FAILED
        for i in range(n):
            if number == 0:
                reach = max(reach, scale[i], abs(z[i] + work[0, i]))
            elif not abs(z[i]) <= MAX_GROWTH * reach:
                # relative to the initial magnitude, as any residual is small compared to diverged values
                m.residual = abs(work[0, i]) / reach
                return NOT_CONVERGED
        m.correction = 0.0
        if m.known != 0:
            for i in range(n):
                correction = 0.0
                for j in range(n):
                    correction += inverse[i, j] * work[0, j]
                m.correction = max(m.correction, abs(correction) / scale[i])
        if m.residual <= MAX_RESIDUAL and m.correction <= MAX_CORRECTION:
            return 0
        grown = m.residual > 2.0 * best
        if grown and number not in JACOBIAN_PASSES:
            for i in range(n):
                work[2, i] *= 0.5
                z[i] -= work[2, i]
            continue
        if m.known == 0 or number in JACOBIAN_PASSES:
            if not _differentiate(m, t, h):
                return MEMBER_FAILED
        elif number > 0:
            _correct_inverse(m)
        best = m.residual
        for i in range(n):
            work[1, i] = work[0, i]
            work[2, i] = 0.0
            for j in range(n):
                work[2, i] += inverse[i, j] * work[0, j]
        for i in range(n):
            z[i] += work[2, i]
    m.known = 0
    return NOT_CONVERGED


@step_function(LOOP_MEMORY)
def _step(m, t, h, u, y):
    members = carray(_members_at(m.members), m.count)
    copy(m.values, address_of(u), 8 * m.given)
    m.passes = 0
    # gather all inputs at the start of the step before any output is overwritten
    for c in range(m.count):
        _gather(m, members[c])
    for c in range(m.count):
        part = members[c]
        if part.react != 0:
            status = call_step(part.step, (part.self, t, h, part.u, part.y))
        else:
            status = call_step(part.save, (part.rewind, 0.0, 0.0, 0, 0))
        if not _check_member(m, c, part, status):
            return MEMBER_FAILED
    status = _solve(m, t, h)
    if status != 0:
        return status
    copy(address_of(y), m.values + 8 * m.given, 8 * m.outputs)
    return 0


class LoopComponent(Composite):
    """A component that solves an algebraic loop: its members, stepped as one continuous component.

    Members are continuous, of period 1, in the order of a pass. Wires join whole ports as in `System`, one for every
    input of a member, and refer to the loop's own inputs as "given.<port>". `cure` has alternatives, for messages.
    """

    INPUT_OWNER = "given"

    def __init__(
        self,
        name: str,
        inputs: tuple[Port, ...],
        members: Sequence[Component],
        wires: Sequence[tuple[str, str]],
        path: str,
        cure: str,
    ):
        self.members, self._path, self._cure = tuple(members), path, cure
        given, outputs = width(inputs), sum(width(member.outputs) for member in members)
        owned = [(self.INPUT_OWNER, inputs), *((member.name, member.outputs) for member in members)]
        named = tuple(replace(port, name=f"{owner}.{port.name}") for owner, ports in owned for port in ports)
        places = port_slices(named)
        order = {member.name: number for number, member in enumerate(members)}
        fed = dict((target, source) for source, target in wires)
        led: list[int] = []
        self._sources: list[np.ndarray] = []
        for member in members:
            sources: list[int] = []
            for port in member.inputs:
                source = fed[f"{member.name}.{port.name}"]
                slots, owner = range(places[source].start, places[source].stop), source.partition(".")[0]
                if order.get(owner, -1) >= order[member.name]:
                    sources += range(given + outputs + len(led), given + outputs + len(led) + port.size)
                    led += slots
                else:
                    sources += slots
            self._sources.append(np.array(sources, dtype=np.uint64))
        if len(led) > MAX_LOOP_VALUES:
            raise InputRefused(f"{path}: {len(led)} values lead back, expected at most {MAX_LOOP_VALUES}; {cure}")
        n = self.size = len(led)
        initial = np.concatenate([np.zeros(0), *(member.initial_outputs for member in members)])
        self._led = np.array(led, dtype=np.uint64)
        self._values = np.zeros(given + outputs + n)
        self._values[given : given + outputs] = initial
        self._values[given + outputs :] = self._values[led]
        self._inverse, self._work = np.zeros((n, n)), np.zeros(_WORK_ROWS * n + n * n)
        self._scale = np.maximum(np.abs(self._values[led]), MIN_SCALE)
        self._u = [np.zeros(width(member.inputs)) for member in members]
        self._table = np.zeros(len(members), dtype=MEMBER_RECORD)
        self._rewinds = []
        place = self._values.ctypes.data + 8 * given
        for row, member, u, sources_ in zip(self._table, members, self._u, self._sources, strict=True):
            row["step"], row["self"], row["finite"] = member.step_address, member.self_address, member.finite
            row["u"], row["u_size"], row["sources"] = u.ctypes.data, len(u), sources_.ctypes.data
            row["y"], row["y_size"] = place, width(member.outputs)
            place += 8 * width(member.outputs)
            row["react"] = member.reaction()
            if not row["react"]:
                rewind = member.rewind()
                if rewind is None:
                    raise InputRefused(
                        f"{member.label or member.name}: cannot go back to the start of a step, so that the loop "
                        f"{path} cannot be solved; {cure}"
                    )
                self._rewinds.append(rewind)
                row["save"], row["restore"] = rewind.save_address, rewind.restore_address
                row["rewind"] = rewind.self_address
        self._memory = np.zeros(1, dtype=LOOP_MEMORY)
        m = self._memory[0]
        m["members"], m["count"], m["given"] = self._table.ctypes.data, len(members), given
        m["outputs"], m["size"], m["values"] = outputs, n, self._values.ctypes.data
        m["led"], m["inverse"], m["scale"] = self._led.ctypes.data, self._inverse.ctypes.data, self._scale.ctypes.data
        m["work"] = self._work.ctypes.data
        super().__init__(
            name=name,
            inputs=inputs,
            outputs=tuple(
                Port(f"{member.name}__{port.name}", port.size, port.unit, port.meaning, port.kind)
                for member in members
                for port in member.outputs
            ),
            sampled=False,
            step_address=_step.address,
            self_address=self._memory.ctypes.data,
            initial_outputs=initial,
            label="the loop",
            keep=self._memory,
        )

    @property
    def passes(self) -> int:
        """Number of passes over the loop's members in the last step."""
        return int(self._memory["passes"][0])

    def requests_end(self, status: int) -> bool:
        culprit, bad = int(self._memory["culprit"][0]), int(self._memory["status"][0])
        return status == MEMBER_FAILED and self.members[culprit].requests_end(bad)

    def explain(self, status: int) -> str:
        culprit, bad, passes, residual = (
            self._memory[name][0].item() for name in ("culprit", "status", "passes", "residual")
        )
        if status == NOT_CONVERGED:
            return (
                f"{self._path} does not converge: the residual is {residual:.3g} after {passes} passes, expected at "
                f"most {MAX_RESIDUAL:g}; {self._cure}; it failed"
            )
        member = self.members[culprit]
        what = "returned NaN or infinity" if bad == NOT_FINITE else member.explain(bad)
        return f"{self._path} failed inside: {member.label} ({member.name}) {what}"

    def pieces(self) -> dict[str, np.ndarray]:
        own = {"values": self._values, "inverse": self._inverse, "scale": self._scale, "known": self._memory["known"]}
        return own | self.member_pieces()

    def lacks_state(self, portable: bool = True) -> str:
        reasons = [(c.label or c.name, why) for c in self.members if (why := c.lacks_state(portable))]
        return "; ".join(f"has {label}, which {why}" for label, why in reasons)
