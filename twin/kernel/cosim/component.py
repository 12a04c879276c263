"""The component interface of the master."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from twin.kernel.compiled.function import c, copy, intrinsic, ir, pointer_to, types
from twin.kernel.compiled.native import Kind, Native
from twin.kernel.cosim.port import Port, by_port, port_record, width


def step_function(
    memory: np.dtype, inputs: tuple[Port, ...] = (), outputs: tuple[Port, ...] = ()
) -> Callable[[Callable], Native]:
    """Decorator: compile `f(m, t, h, u, y) -> int32` as a component's step.

    `m` is the component's memory, a record of dtype `memory`. `u` and `y` are records with a field for each port, so
    that a step reads `u.F_ee_B[2]` and writes `y.dp_z`, and a wrong name does not compile. The compiled step is kept
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


_MEMORY = np.dtype([("record", "i8"), ("copy", "i8"), ("size", "i8")], align=True)


@step_function(_MEMORY)
def _save(m, t, h, u, y):
    copy(m.copy, m.record, m.size)
    return 0


@step_function(_MEMORY)
def _restore(m, t, h, u, y):
    copy(m.record, m.copy, m.size)
    return 0


def record_rewind(record: np.ndarray) -> Rewind:
    """Of a component whose whole state is `record`, (1,)."""
    saved = record.copy()
    memory = np.array([(record.ctypes.data, saved.ctypes.data, record.nbytes)], dtype=_MEMORY)
    return Rewind(_save.address, _restore.address, memory.ctypes.data, (memory, saved))


NOT_FINITE = 1 << 32
"""Status the master gives a component whose step returned NaN or infinity; beyond int32, so no step can return it."""


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
    keep: Any = field(default=None, repr=False)

    def initial(self, name: str) -> np.ndarray:
        """Initial values of the output port `name`."""
        return by_port(self.outputs, self.initial_outputs)[name]

    def explain(self, status: int) -> str:
        """What a bad `status` of this component's step means, as the verb phrase of a sentence."""
        return f"returned status {status}"

    def rewind(self) -> Rewind | None:
        """How to repeat its steps, from now on possible; None: it cannot."""
        return None

    def keep_time(self, clock: np.ndarray) -> None:
        """Take note of the clock of the simulation it is part of: `clock[0]` is the tick being stepped."""

    def take_messages(self) -> list[tuple[int, str]]:
        """(tick, text): what it had to say since it was last asked, for people."""
        return []

    def close(self) -> None:
        """Release what the component holds outside Python's memory."""


class NativeComponent(Component):
    """A component with a compiled step over a record, as most are.

    Args:
        name, inputs, outputs, sampled, period: see `Component`.
        step: made by `native.step_function`.
        memory: (1,) record that the step works on.
        initial_outputs: zeros if not given; a sampled component overwrites them at tick 0.
        keep: what `memory` points to, unless `pointers` says it.
        rewindable: whether all that its steps change lies in `memory` itself.
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
        rewindable: bool = False,
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
        self._rewindable = rewindable

    def rewind(self) -> Rewind | None:
        return record_rewind(self.memory) if self._rewindable else None


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
