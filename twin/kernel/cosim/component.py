"""Components of the master: interface, compiled steps, and saving of their memory."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from twin.kernel.compiled.function import c, carray, copy, intrinsic, ir, njit, pointer_to, types
from twin.kernel.compiled.native import Kind, Native, entry
from twin.kernel.cosim.port import Port, by_port, port_record, record, state_fields, width
from twin.kernel.errors import InputRefused

PIECE_RECORD = record(array="i8", copy="i8", size="i8")
"""A piece of memory: its address, the address of its copy, and its size (bytes)."""
_PIECES_RECORD = record(table="i8", count="i8")
NOT_FINITE = 1 << 32
"""Status from the master if a step wrote NaN or infinity; beyond int32, so a step cannot return it itself."""
doubles_at = pointer_to(np.float64)
bytes_at = pointer_to(np.uint8)
integers_at = pointer_to(np.uint64)
"""View of unsigned integers at an address; an index read from it cannot be negative, which saves a check."""
pieces_at = pointer_to(PIECE_RECORD)
_C_TYPES = {"double": "f64", "size": "i64", "int": "i32", "byte": "i8"}


def step_function(
    memory: np.dtype, inputs: tuple[Port, ...] = (), outputs: tuple[Port, ...] = ()
) -> Callable[[Callable], Native]:
    """Decorate a function `f(m, t, h, u, y) -> int32` to be compiled as the step of a component.

    `m` is the component's memory, a record of dtype `memory`. `u` and `y` are records with a field for each port: a
    step reads `u.force[2]` and writes `y.speed`, and a wrong name does not compile. Without ports, or if they are known
    only at its creation, `u` or `y` is a pointer to doubles, which `carray` converts to an array. Division by zero
    gives NaN or infinity; functions that `f` calls need `error_model="numpy"` for that.
    """
    u, y = (port_record(ports) if ports else "doubles" for ports in (inputs, outputs))
    takes: tuple[Kind, ...] = (memory, "double", "double", u, y)
    return lambda function: Native("int32", takes, function)


def c_function(returns: str, *kinds: str, convert: Callable | None = None) -> Any:
    """Create a function (address, (arguments)) for compiled code that calls the C function at that address.

    Arguments are "pointer", "double", "size" (64 bit), "int" (32 bit) or "byte", results the same but "double".
    Compiled code has a float64 for a double and an int64 for the others. `convert(builder, value)` makes that int64 of
    the result instead.
    """

    @intrinsic
    def call(typingctx, function, arguments):
        native, *takes = (getattr(c, _C_TYPES.get(kind, kind)) for kind in (returns, *kinds))

        def codegen(context, builder, signature, given):
            passed = []
            for i, kind in enumerate(kinds):
                value = builder.extract_value(given[1], i)
                if kind == "pointer":
                    value = builder.inttoptr(value, c.pointer)
                elif kind in ("int", "byte"):
                    value = builder.trunc(value, takes[i])
                passed.append(value)
            target = builder.inttoptr(given[0], ir.FunctionType(native, takes).as_pointer())
            returned = builder.call(target, passed)
            if convert:
                return convert(builder, returned)
            return builder.ptrtoint(returned, c.i64) if returns == "pointer" else builder.sext(returned, c.i64)

        given = [types.float64 if kind == "double" else types.int64 for kind in kinds]
        return types.int64(types.int64, types.Tuple(given)), codegen

    return call


call_step = c_function("int", "pointer", "double", "double", "pointer", "pointer")
"""Step of a component, `int32 step(self, t, h, u, y)`, called by its address."""


@intrinsic
def address_of(typingctx, pointer):
    """Return the address (int64) of a pointer or record argument of a compiled step."""

    def codegen(context, builder, signature, arguments):
        return builder.ptrtoint(arguments[0], c.i64)

    return types.int64(pointer), codegen


@intrinsic
def clock_cycles(typingctx):
    """Read the processor's cycle counter; differences are proportional to time."""

    def codegen(context, builder, signature, arguments):
        counter = builder.module.declare_intrinsic("llvm.readcyclecounter", fnty=ir.FunctionType(c.i64, []))
        return builder.call(counter, [])

    return types.int64(), codegen


@dataclass(frozen=True)
class Rewind:
    """Functions, with the signature of a step, that save and restore a component's state before a step is repeated.

    `self_address` is the memory of both; the last saved state can be restored any number of times.
    """

    save_address: int
    restore_address: int
    self_address: int
    keep: Any = field(default=None, repr=False)


@entry("nothing", "int", "int", "int", "int", at_once=True)
def copy_pieces(table, count, buffer, back):
    """Copy pieces of memory in a `PIECE_RECORD` table to their copies, or, if `back` is set, from them.

    Addresses of copies are counted from `buffer`; 0 if they are addresses of memory.
    """
    pieces = carray(pieces_at(table), count)
    for i in range(count):
        if back:
            copy(pieces[i].array, buffer + pieces[i].copy, pieces[i].size)
        else:
            copy(buffer + pieces[i].copy, pieces[i].array, pieces[i].size)


@step_function(_PIECES_RECORD)
def _save(m, t, h, u, y):
    copy_pieces(m.table, m.count, 0, 0)
    return 0


@step_function(_PIECES_RECORD)
def _restore(m, t, h, u, y):
    copy_pieces(m.table, m.count, 0, 1)
    return 0


def contiguous_parts(array: np.ndarray) -> list[tuple[int, int]]:
    """Return (address, bytes) of the contiguous parts of `array`, in the order of its values."""
    if array.flags.c_contiguous:
        return [(array.ctypes.data, array.nbytes)] if array.size else []
    if array.ndim > 1:
        return [run for part in array for run in contiguous_parts(part)]
    return [(array.ctypes.data + i * array.strides[0], array.itemsize) for i in range(len(array))]


def piece_table(arrays: Iterable[np.ndarray], copy_address: int) -> np.ndarray:
    """Make the `PIECE_RECORD` table of `arrays`: addresses, sizes, and places of copies from `copy_address` on."""
    rows = []
    for address, size in (run for array in arrays for run in contiguous_parts(array)):
        rows.append((address, copy_address, size))
        copy_address += size
    return np.array(rows, dtype=PIECE_RECORD)


class Pieces:
    """Pieces of component memory copied together to and from a row of `size` bytes, to save and restore state.

    `at`: address of a `PIECE_RECORD` table with offsets in the row, and number of records.
    """

    def __init__(self, arrays: Iterable[np.ndarray]):
        self._arrays = list(arrays)
        self._table = piece_table(self._arrays, 0)
        self.size = int(self._table["size"].sum())
        self.at = self._table.ctypes.data, len(self._table)

    def save(self) -> np.ndarray:
        """Copy the present content of the memory pieces to a new row, uint8 (size,)."""
        row = np.empty(self.size, dtype=np.uint8)
        copy_pieces(*self.at, row.ctypes.data, 0)
        return row

    def restore(self, row: np.ndarray) -> None:
        """Copy a saved `row`, from here or from pieces of the same form, back to the memory pieces."""
        copy_pieces(*self.at, row.ctypes.data, 1)


class Holder(Protocol):
    """An object that saves and restores component state outside the master's memory: in an FMU, object or process.

    A token identifies a saved state. It belongs to its holder, which frees all tokens when it is closed.
    """

    def save_state(self) -> Any:
        """Save the present component state and return the token that identifies it."""

    def restore_state(self, token: Any) -> None:
        """Restore the component state saved as `token`; a token may be restored repeatedly."""

    def free(self, token: Any) -> None:
        """Free the saved state identified by `token`; safe if it is already freed."""

    def pack(self, token: Any) -> bytes:
        """Serialise the component state saved as `token`, for another process."""

    def unpack(self, content: bytes) -> Any:
        """Create a token from a serialised component state, possibly of another process."""


@njit(cache=True)
def step_status(status, outputs, part):
    """Return 0 for a successful step, else its status, or `NOT_FINITE` if an output is not `finite` and has to be.

    `outputs` is their address, `part` a record with `y_size` and `finite`.
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
    """A participant of a co-simulation, stepped through a function address.

    `int32 step(void *self, double t, double h, const double *u, double *y)` reads the inputs `u`, writes the outputs
    `y` and returns 0 (or 1, a warning); any other status stops the run.

    Attributes:
        name: unique in the system.
        inputs, outputs: ports, in the order of `u` and `y`.
        sampled: True if it is evaluated at t_k, without advancing time; False if it steps from t_k to t_k + h.
        initial_outputs: outputs valid before tick 0.
        period: step of the component (ticks).
        label: name in error messages, e.g. the file name of an FMU.
        finite: whether NaN or infinity in an output is a failure. False for components that model a broken sensor, and
            for components that must survive one.
        unread: (number of outputs,) int64: 1 for an output that nothing reads and that need not be finite, 2 + the tick
            of the step that first made it non-finite; None if there is no such output.
        alive: whether it is passed unchanged from one system to the next; states contain its outputs, not its memory.
        keep: owner of the memory behind the addresses.
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
        """Return the initial values of the component's output port `name`."""
        return by_port(self.outputs, self.initial_outputs)[name]

    def explain(self, status: int) -> str:
        """Describe a failure `status` of a step, as a verb phrase for an error message."""
        return f"returned status {status}"

    def requests_end(self, status: int) -> bool:
        """Whether a failure `status` of the component's step requests a regular end of the run."""
        return False

    def pieces(self) -> dict[str, np.ndarray]:
        """Return views of the component's state in this process, by name, in fixed order: memory that steps change."""
        return {}

    def holders(self) -> dict[str, Holder]:
        """Return the objects that save component state outside the master's memory, by name."""
        return {}

    def refuse_index(self) -> None:
        """Refuse a restored state with an index beyond its array, which a step would dereference."""

    def lacks_state(self, portable: bool = True) -> str:
        """Return why the state cannot be saved (for another process if `portable`), as a verb phrase; "" if it can."""
        return "does not declare what its steps change"

    def rewind(self) -> Rewind | None:
        """Return functions that save and restore the component to repeat a step; None if it cannot repeat steps."""
        if self.lacks_state(portable=False) or self.holders():
            return None
        pieces = self.pieces()
        copies = np.empty(sum(array.nbytes for array in pieces.values()), dtype=np.uint8)
        table = piece_table(pieces.values(), copies.ctypes.data)
        memory = np.array([(table.ctypes.data, len(table))], dtype=_PIECES_RECORD)
        return Rewind(_save.address, _restore.address, memory.ctypes.data, (memory, table, copies, pieces))

    def reaction(self) -> int:
        """Return the address of a function that computes the outputs for other inputs at the end of the last step.

        It has the signature of a step. 0 if there is none, so that the step has to be repeated.
        """
        return 0

    def keep_time(self, clock: np.ndarray) -> None:
        """Give the component access to the simulation's clock: `clock[0]` is the tick being stepped."""

    def take_messages(self) -> list[tuple[int, str]]:
        """Return the component's messages (tick, text) for the user since the last call, and clear them."""
        return []

    def close(self) -> None:
        """Release the component's resources outside Python's memory."""


class NativeComponent(Component):
    """A component with a compiled step over a record; the fields declared as `state` are its state.

    `step` is decorated by `step_function`, `memory` its record, (1,). `pointers`: field of `memory` -> array whose
    address it gets; `keep` owns memory behind other addresses. Without `keep`, `memory` and `pointers` are all data of
    the step, which can then run in another place: the component is `portable`. A sampled one overwrites
    `initial_outputs` (None for zeros) at tick 0.
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
            # -1, before the first step, is the last index in compiled code
            if one.below and not np.all((values >= -1) & (values < np.maximum(one.limit(self.memory), 1))):
                raise InputRefused(f"{self.name}.{one.name} = {values.flat[0]}: is outside its number of elements")


class Composite(Component):
    """A component made of others: their states and messages are part of its own."""

    members: Sequence[Component]

    def member_pieces(self) -> dict[str, np.ndarray]:
        """Return the pieces of the members, as "member.piece"."""
        return {f"{one.name}.{name}": array for one in self.members for name, array in one.pieces().items()}

    def holders(self) -> dict[str, Holder]:
        return {f"{one.name}.{name}": holder for one in self.members for name, holder in one.holders().items()}

    def refuse_index(self) -> None:
        for one in self.members:
            one.refuse_index()

    def keep_time(self, clock: np.ndarray) -> None:
        for one in self.members:
            one.keep_time(clock)

    def take_messages(self) -> list[tuple[int, str]]:
        return [message for one in self.members for message in one.take_messages()]

    def close(self) -> None:
        for one in self.members:
            one.close()


@dataclass(frozen=True)
class MemoryPlace:
    """A field of a record in the memory of the component `component`.

    `record` is the path of the record in the memory, joined by "."; "" for the memory itself.
    """

    component: str
    record: str
    field: str

    def memory_of(self, owner: Component) -> np.ndarray | None:
        """Return a view of the field in the memory of `owner`, (1,) or (1, size); None if `owner` lacks the field."""
        try:
            memory = owner.memory[0:1]  # type: ignore[attr-defined]
            for name in filter(None, (*self.record.split("."), self.field)):
                memory = memory[name]
            return memory
        except (AttributeError, TypeError, ValueError, IndexError):
            return None
