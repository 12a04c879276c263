"""The component interface of the master."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from twin.kernel.compiled.function import c, carray, copy, intrinsic, ir, njit, pointer_to, types
from twin.kernel.compiled.native import Kind, Native, entry
from twin.kernel.cosim.port import Port, by_port, port_record, record, state_fields, width
from twin.kernel.errors import InputRefused

PIECE_RECORD = record(array="i8", copy="i8", size="i8")
"""Addresses of a piece of memory and of its copy, and their bytes."""
_PIECES_RECORD = record(table="i8", count="i8")
NOT_FINITE = 1 << 32
"""Status the master gives a component whose step returned NaN or infinity; beyond int32, so no step can return it."""


def step_function(
    memory: np.dtype, inputs: tuple[Port, ...] = (), outputs: tuple[Port, ...] = ()
) -> Callable[[Callable], Native]:
    """Decorator: compile `f(m, t, h, u, y) -> int32` as a component's step.

    `m` is the component's memory, a record of dtype `memory`. `u` and `y` are records with a field for each port, so
    that a step reads `u.force[2]` and writes `y.speed`, and a wrong name does not compile. The compiled step is kept
    on disk. Dividing by zero gives NaN or infinity; functions that `f` calls need `error_model="numpy"` of their own
    for that.

    Args:
        memory: of the component.
        inputs, outputs: its ports. Where none are given, because there are none or because they are known only when a
            component is made, `u` or `y` is a pointer to doubles, of which `carray` makes an array.
    """
    u, y = (port_record(ports) if ports else "doubles" for ports in (inputs, outputs))
    takes: tuple[Kind, ...] = (memory, "double", "double", u, y)
    return lambda function: Native("int32", takes, function)


@intrinsic
def call_step(typingctx, function, self, t, h, u, y):
    """`int32 step(void *self, double t, double h, const double *u, double *y)` at address `function`."""
    signature = types.int32(types.int64, types.int64, types.float64, types.float64, types.int64, types.int64)

    def codegen(context, builder, signature, arguments):
        f, self_, t_, h_, u_, y_ = arguments
        kind = ir.FunctionType(c.i32, [c.pointer, c.f64, c.f64, c.pointer, c.pointer])
        pointers = [builder.inttoptr(value, c.pointer) for value in (self_, u_, y_)]
        target = builder.inttoptr(f, kind.as_pointer())
        return builder.call(target, [pointers[0], t_, h_, pointers[1], pointers[2]])

    return signature, codegen


@intrinsic
def address_of(typingctx, pointer):
    """The address (int64) behind an argument of a compiled step that is a pointer or a record."""

    def codegen(context, builder, signature, arguments):
        return builder.ptrtoint(arguments[0], c.i64)

    return types.int64(pointer), codegen


doubles_at = pointer_to(np.float64)
bytes_at = pointer_to(np.uint8)
integers_at = pointer_to(np.uint64)
"""Unsigned: an index read from it is never negative, which saves a check."""


@intrinsic
def clock_cycles(typingctx):
    """The processor's cycle counter; differences are proportional to time."""

    def codegen(context, builder, signature, arguments):
        counter = builder.module.declare_intrinsic("llvm.readcyclecounter", fnty=ir.FunctionType(c.i64, []))
        return builder.call(counter, [])

    return types.int64(), codegen


@dataclass(frozen=True)
class Rewind:
    """How a component goes back: two functions of a step's signature, which read neither time nor inputs.

    Attributes:
        save_address, restore_address: `restore` brings back what `save` last kept, as often as it is called.
        self_address: memory that both are called with.
        keep: whatever owns the memory behind the addresses.
    """

    save_address: int
    restore_address: int
    self_address: int
    keep: Any = field(default=None, repr=False)


pieces_at = pointer_to(PIECE_RECORD)


@njit(cache=True)
def save_pieces(table, count):
    """Copy the `count` pieces of memory of the `PIECE_RECORD` records at address `table`."""
    pieces = carray(pieces_at(table), count)
    for i in range(count):
        copy(pieces[i].copy, pieces[i].array, pieces[i].size)


@njit(cache=True)
def restore_pieces(table, count):
    """The copies become what is there again."""
    pieces = carray(pieces_at(table), count)
    for i in range(count):
        copy(pieces[i].array, pieces[i].copy, pieces[i].size)


@entry("nothing", "int", "int", "int", "int", at_once=True)
def copy_pieces(table, count, buffer, back):
    """Copy pieces of memory to their places in `buffer`, or `back` from there; `PIECE.copy` is the place."""
    pieces = carray(pieces_at(table), count)
    for i in range(count):
        if back:
            copy(pieces[i].array, buffer + pieces[i].copy, pieces[i].size)
        else:
            copy(buffer + pieces[i].copy, pieces[i].array, pieces[i].size)


@step_function(_PIECES_RECORD)
def _save(m, t, h, u, y):
    save_pieces(m.table, m.count)
    return 0


@step_function(_PIECES_RECORD)
def _restore(m, t, h, u, y):
    restore_pieces(m.table, m.count)
    return 0


def contiguous_parts(array: np.ndarray) -> list[tuple[int, int]]:
    """(address, bytes) of the parts of `array` that lie in one piece, in the order of its values."""
    if array.flags.c_contiguous:
        return [(array.ctypes.data, array.nbytes)] if array.size else []
    return [run for part in array for run in contiguous_parts(part)] if array.ndim > 1 else _single_elements(array)


def _single_elements(array: np.ndarray) -> list[tuple[int, int]]:
    start, (stride,) = array.ctypes.data, array.strides
    return [(start + i * stride, array.itemsize) for i in range(len(array))]


def piece_table(arrays: Iterable[np.ndarray], copy_address: int) -> np.ndarray:
    """The `PIECE_RECORD` records of `arrays` with copies one after the other from `copy_address` on."""
    rows = []
    for address, size in (run for array in arrays for run in contiguous_parts(array)):
        rows.append((address, copy_address, size))
        copy_address += size
    return np.array(rows, dtype=PIECE_RECORD)


class Pieces:
    """Pieces of memory that are copied together, one after the other, to a row of bytes and back.

    Args:
        arrays: in which they lie.

    Attributes:
        at: address of a table of `PIECE_RECORD`, with the place of each in the row, and how many there are.
        size: of the row, bytes.
    """

    def __init__(self, arrays: Iterable[np.ndarray]):
        self._arrays = list(arrays)
        self._table = piece_table(self._arrays, 0)
        self.size = int(self._table["size"].sum())
        self.at = self._table.ctypes.data, len(self._table)

    def save(self) -> np.ndarray:
        """What is there now (size,)."""
        row = np.empty(self.size, dtype=np.uint8)
        copy_pieces(*self.at, row.ctypes.data, 0)
        return row

    def restore(self, row: np.ndarray) -> None:
        """Let `row`, taken here or of like pieces elsewhere, be what is there."""
        copy_pieces(*self.at, row.ctypes.data, 1)


def pieces_rewind(pieces: Mapping[str, np.ndarray]) -> Rewind:
    """Of a component whose whole state are `pieces`."""
    copies = np.empty(sum(array.nbytes for array in pieces.values()), dtype=np.uint8)
    table = piece_table(pieces.values(), copies.ctypes.data)
    memory = np.array([(table.ctypes.data, len(table))], dtype=_PIECES_RECORD)
    return Rewind(_save.address, _restore.address, memory.ctypes.data, (memory, table, copies, pieces))


class Holder(Protocol):
    """Holds a part of a component's state where the master cannot copy it: inside an FMU, a Python object, a process.

    A token stands for what was held at one time. It belongs to its holder, which frees all of them when it is closed.
    """

    def save_state(self) -> Any:
        """A token of what is held now."""

    def restore_state(self, token: Any) -> None:
        """Hold what `token` stands for; as often as it is asked for."""

    def free(self, token: Any) -> None:
        """Forget `token`; harmless if it is forgotten already."""

    def pack(self, token: Any) -> bytes:
        """What `token` stands for, for another process."""

    def unpack(self, content: bytes) -> Any:
        """A token of what `pack` gave, there.

        Raises:
            InputRefused: it is nothing that `pack` gives.
        """


@njit(cache=True)
def step_status(status, outputs, part):
    """0 if a step went well, else its status, or `NOT_FINITE`; `master` asks by itself, which is faster.

    Args:
        status: that the step returned.
        outputs: address of what it wrote.
        part: record of the component, with `y_size`, and `finite`: whether NaN and infinity are bad.
    """
    if status != 0 and status != 1:
        return status
    y = carray(doubles_at(outputs), part.y_size)
    for j in range(part.y_size):
        if not np.isfinite(y[j]) and part.finite:
            return NOT_FINITE
    return 0


@dataclass
class Component:
    """One participant of a co-simulation, stepped by address.

    `int32 step(void *self, double t, double h, const double *u, double *y)` reads the inputs `u`, writes the outputs
    `y` and returns 0 (or 1, a warning); anything else stops the run.

    Attributes:
        name: unique in the system.
        inputs, outputs: ports, in the order in which `u` and `y` hold them.
        sampled: True: evaluated AT t_k, no time passes in it. False: goes from t_k to t_k + h.
        step_address, self_address: the step function and its memory.
        initial_outputs: outputs that are valid before tick 0.
        period: in ticks.
        label: what an error sentence calls it (an FMU's file name, say).
        finite: whether NaN or infinity in an output is a failure that ends the run. False for what plays a broken
            sensor, and for what must live on behind one.
        unread: (number of outputs,) int64: 1 for an output that nothing reads and that need not be finite, 2 + the
            tick of the step after which it first was not; None if there is no such output.
        alive: whether it is handed from one system to the next as it is: states hold its outputs, and nothing inside.
        keep: whatever owns the memory behind the addresses.
    """

    name: str
    inputs: tuple[Port, ...]
    outputs: tuple[Port, ...]
    sampled: bool
    step_address: int
    self_address: int
    initial_outputs: np.ndarray
    period: int = 1
    label: str = ""
    finite: bool = True
    unread: np.ndarray | None = None
    alive: bool = False
    keep: Any = field(default=None, repr=False)

    def initial(self, name: str) -> np.ndarray:
        """Initial values of the output port `name`."""
        return by_port(self.outputs, self.initial_outputs)[name]

    def explain(self, status: int) -> str:
        """What a bad `status` of this component's step means, as the verb phrase of a sentence."""
        return f"returned status {status}"

    def requests_end(self, status: int) -> bool:
        """Whether a bad `status` of its step says that the run is to end here, regularly."""
        return False

    def pieces(self) -> dict[str, np.ndarray]:
        """What its steps change in this process's memory, by name: views, always in the same order."""
        return {}

    def holders(self) -> dict[str, Holder]:
        """By name what holds the rest of its state."""
        return {}

    def refuse_index(self) -> None:
        """Refuse memory in which an index leads beyond its array, which a step would follow.

        Raises:
            InputRefused: it names the field.
        """

    def lacks_state(self, portable: bool = True) -> str:
        """Why its state cannot be saved, as the verb phrase of a sentence; "" if it can.

        Args:
            portable: for another process, and not only to go back in this one.
        """
        return "does not say what its steps change"

    def rewind(self) -> Rewind | None:
        """How to repeat its steps, from now on possible; None: it cannot."""
        if self.lacks_state(portable=False) or self.holders():
            return None
        return pieces_rewind(self.pieces())

    def reaction(self) -> int:
        """Address of a function of a step's signature that gives the outputs for other inputs at the time that it has
        come to; 0: it has none, and has to make its step again."""
        return 0

    def keep_time(self, clock: np.ndarray) -> None:
        """Take note of the clock of the simulation it is part of: `clock[0]` is the tick being stepped."""

    def take_messages(self) -> list[tuple[int, str]]:
        """(tick, text): what it had to say since it was last asked, for people."""
        return []

    def close(self) -> None:
        """Release what the component holds outside Python's memory."""


class NativeComponent(Component):
    """A component with a compiled step over a record, as most are; what is declared as `state` there is its state.

    Args:
        name, inputs, outputs, sampled, period: see `Component`.
        step: made by `native.step_function`.
        memory: (1,) record that the step works on.
        initial_outputs: zeros if not given; a sampled component overwrites them at tick 0.
        keep: what `memory` points to, unless `pointers` says it.
        pointers: by field of `memory` the array whose address is put there; then all that the step works on is known,
            and can be taken elsewhere.

    Attributes:
        step, memory, pointers: see there.
        portable: whether `memory` and `pointers` are all that the step works on.
    """

    def __init__(
        self,
        name: str,
        inputs: tuple[Port, ...],
        outputs: tuple[Port, ...],
        sampled: bool,
        step: Any,
        memory: np.ndarray,
        initial_outputs: np.ndarray | None = None,
        period: int = 1,
        keep: Any = None,
        pointers: Mapping[str, np.ndarray] | None = None,
    ):
        self.step, self.memory, self.pointers, self.portable = step, memory, dict(pointers or {}), keep is None
        for field_name, array in self.pointers.items():
            memory[field_name] = array.ctypes.data
        super().__init__(
            name=name,
            inputs=inputs,
            outputs=outputs,
            sampled=sampled,
            step_address=step.address,
            self_address=memory.ctypes.data,
            initial_outputs=np.zeros(width(outputs)) if initial_outputs is None else initial_outputs,
            period=period,
            keep=(memory, keep),
        )

    def pieces(self) -> dict[str, np.ndarray]:
        fields = state_fields(self.memory.dtype)
        return {one.name: self.pointers.get(one.name, one.view_in(self.memory)) for one in fields}

    def lacks_state(self, portable: bool = True) -> str:
        return ""

    def refuse_index(self) -> None:
        for one in state_fields(self.memory.dtype):
            values = one.view_in(self.memory)
            # -1, before the first step, is the last one to compiled code
            if one.below and not np.all((values >= -1) & (values < np.maximum(one.limit(self.memory), 1))):
                raise InputRefused(f"{self.name}.{one.name} = {values.flat[0]}: leads beyond what it counts")


@dataclass(frozen=True)
class MemoryPlace:
    """The `field` of a record in the memory of the component with the name `component`.

    `record`: names of records in records, joined by "."; "" the memory itself.
    """

    component: str
    record: str
    field: str

    def memory_of(self, owner: Component) -> np.ndarray | None:
        """The numbers there, a view (1,) or (1, size); None if `owner` has no such memory."""
        try:
            memory = owner.memory[0:1]  # type: ignore[attr-defined]
            for name in filter(None, (*self.record.split("."), self.field)):
                memory = memory[name]
            return memory
        except (AttributeError, TypeError, ValueError, IndexError):
            return None
