"""Outputs that are read within a step (FMI 3.0, 4.2): how far they stray beyond what they are at both of its ends.

The FMU says when, by fmi3IntermediateUpdateCallback, and only the states of its solver that this has accepted count.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from twin.compiled.function import carray, njit, pointer_to
from twin.cosim.native import doubles_at
from twin.drive.calls import access_3
from twin.drive.status import GET_WITHIN
from twin.drive.variable import Variable
from twin.errors import ComponentFailed

if TYPE_CHECKING:
    from twin.drive.instance import Instance

ROW = np.dtype(
    [
        ("begin", "f8"),
        ("low", "f8"),
        ("high", "f8"),
        ("low_at", "f8"),
        ("high_at", "f8"),
        ("read", "i8"),
        ("steps", "i8"),
        ("all_read", "i8"),
        ("beyond", "f8"),
        ("at", "f8"),
    ],
    align=True,
)
"""Of one value: what it is at the start of a step; least and largest within it, when (s), and how often it was read;
then of all steps until now: how many, how often it was read, and how far it went beyond both ends at most, and when."""

WATCH = np.dtype(
    [
        ("instance", "i8"),
        ("get", "i8"),
        ("references", "i8"),
        ("variables", "i8"),
        ("values", "i8"),
        ("buffer", "i8"),
        ("rows", "i8"),
        ("kept", "i8"),
    ],
    align=True,
)
"""Addresses of instance, fmi3GetFloat64 and references; how many variables and values; addresses of what is read, of a
`ROW` for each value, and of these as they were before a part of a step that may be discarded."""

_watch_at, _rows_at = pointer_to(WATCH), pointer_to(ROW)


@njit(cache=True)
def _get(w):
    """Read all values; 0, or the bad status."""
    status = access_3(w.get, w.instance, w.references, w.variables, w.buffer, w.values)
    return GET_WITHIN + status if status > 1 else 0


@njit(cache=True)
def begin_watch(address):
    """A step begins."""
    w = carray(_watch_at(address), 1)[0]
    rows = carray(_rows_at(w.rows), w.values)
    for j in range(w.values):
        rows[j].low, rows[j].high, rows[j].read = np.inf, -np.inf, 0
    count_part(address, True)


@njit(cache=True)
def watch(address, t):
    """Read all values as they are at `t` within a step; 0, or the bad status."""
    w = carray(_watch_at(address), 1)[0]
    status = _get(w)
    if status != 0:
        return status
    rows, values = carray(_rows_at(w.rows), w.values), carray(doubles_at(w.buffer), w.values)
    for j in range(w.values):
        rows[j].read += 1
        if values[j] < rows[j].low:
            rows[j].low, rows[j].low_at = values[j], t
        if values[j] > rows[j].high:
            rows[j].high, rows[j].high_at = values[j], t
    return 0


@njit(cache=True)
def count_part(address, made):
    """A part of a step is over: it was `made`, or discarded and nothing of it counts."""
    w = carray(_watch_at(address), 1)[0]
    rows, kept = carray(_rows_at(w.rows), w.values), carray(_rows_at(w.kept), w.values)
    for j in range(w.values):
        if made:
            kept[j] = rows[j]
        else:
            rows[j] = kept[j]


@njit(cache=True)
def end_watch(address):
    """A step is over; 0, or the bad status of reading what it has come to."""
    w = carray(_watch_at(address), 1)[0]
    status = _get(w)
    if status != 0:
        return status
    rows, values = carray(_rows_at(w.rows), w.values), carray(doubles_at(w.buffer), w.values)
    for j in range(w.values):
        above = rows[j].high - max(rows[j].begin, values[j])
        below = min(rows[j].begin, values[j]) - rows[j].low
        if max(above, below) > rows[j].beyond:
            rows[j].beyond = max(above, below)
            rows[j].at = rows[j].high_at if above >= below else rows[j].low_at
        rows[j].steps += 1
        rows[j].all_read += rows[j].read
        rows[j].begin = values[j]
    return 0


class Stray(NamedTuple):
    """What one value of an FMU does within steps.

    Attributes:
        variable: of the FMU.
        name: of the value, which is that of the variable if it has one only.
        beyond: by how much it goes beyond what it is at both ends of a step at most, in the FMU's own unit.
        t: when (s); NaN: it never does.
        reads: how often it is read, per step.
    """

    variable: Variable
    name: str
    beyond: float
    t: float
    reads: float


class Watch:
    """Outputs of an instance that are read within its steps, from now on.

    Args:
        instance: from whose start values it goes on.
        variables: its Float64 outputs that it was told of when it was made.

    Attributes:
        memory: `WATCH`, (1,).
        rows: what changes with every step, (values,).

    Raises:
        ComponentFailed: they cannot be read.
    """

    def __init__(self, instance: "Instance", variables: Sequence[Variable]):
        self._variables = variables
        try:
            begin = instance.read(variables)
        # FMPy's FMICallException
        except Exception as problem:
            said = f"an output that can be read within a step cannot be read before the first: {problem}"
            raise ComponentFailed(f"{instance.description.path.name}: {said}") from None
        self.rows, self._kept = np.zeros((2, len(begin)), dtype=ROW)
        self.rows["begin"], self.rows["at"] = begin, np.nan
        self._references = np.array([v.reference for v in variables], dtype=np.uint32)
        self._buffer = np.zeros(len(begin))
        self.memory = np.zeros(1, dtype=WATCH)
        w = self.memory[0]
        w["instance"], w["get"] = instance.handle, instance.address("GetFloat64")
        w["variables"], w["values"] = len(variables), len(begin)
        w["references"], w["buffer"] = self._references.ctypes.data, self._buffer.ctypes.data
        w["rows"], w["kept"] = self.rows.ctypes.data, self._kept.ctypes.data

    @property
    def strays(self) -> list[Stray]:
        """Of every value, what it has done until now."""
        named = [(v, f"{v.name}[{i + 1}]" if v.size > 1 else v.name) for v in self._variables for i in range(v.size)]
        return [
            Stray(v, name, float(row["beyond"]), float(row["at"]), float(row["all_read"] / max(row["steps"], 1)))
            for (v, name), row in zip(named, self.rows, strict=True)
        ]
