"""Calls by address: what lets one compiled loop step components that it has never seen.

Addresses travel as int64 run-time values, so compiled callers are cached across processes although every process loads
its libraries elsewhere.
"""

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numba.extending
import numpy as np
from llvmlite import ir
from numba import cfunc, from_dtype, types
from numba.core import cgutils

from twin.cosim.port import Port, port_record

_I32, _I64, _F64, _VOID = ir.IntType(32), ir.IntType(64), ir.DoubleType(), ir.IntType(8).as_pointer()
_DOUBLES = types.CPointer(types.float64)

# numba's type stub takes the typing context for an argument of the call
intrinsic: Any = numba.extending.intrinsic


class Step:
    """A component's step; compiled, or loaded from the cache, when its address is asked for the first time.

    Most runs need few of the components there are, and compiling takes seconds.
    """

    def __init__(self, signature: Any, function: Callable):
        self.signature, self.function = signature, function

    @cached_property
    def address(self) -> int:
        """Where the compiled step is."""
        return self._compiled.address

    @cached_property
    def _compiled(self) -> Any:
        # an exception would be printed and lost, and the step's status with it; NaN and infinity are seen by the master
        return cfunc(self.signature, cache=True, error_model="numpy")(self.function)


def step_function(
    memory: np.dtype, inputs: tuple[Port, ...] = (), outputs: tuple[Port, ...] = ()
) -> Callable[[Callable], Step]:
    """Decorator: compile `f(m, t, h, u, y) -> int32` as a component's step.

    `m` is the component's memory, a record of dtype `memory`. `u` and `y` are records with a field for each port, so
    that a step reads `u.F_ee_B[2]` and writes `y.dp_z`, and a wrong name does not compile. The compiled step is cached
    on disk. Dividing by zero gives NaN or infinity; functions that `f` calls need `error_model="numpy"` of their own
    for that.

    Args:
        memory: of the component.
        inputs, outputs: its ports. Where none are given, because there are none or because they are known only when a
            component is made, `u` or `y` is a pointer to doubles, of which `numba.carray` makes an array.
    """
    u, y = (from_dtype(port_record(ports)) if ports else _DOUBLES for ports in (inputs, outputs))
    signature = types.int32(from_dtype(memory), types.float64, types.float64, u, y)
    return lambda function: Step(signature, function)


@intrinsic
def call_step(typingctx, function, self, t, h, u, y):
    """`int32 step(void *self, double t, double h, const double *u, double *y)` at address `function`."""
    signature = types.int32(types.int64, types.int64, types.float64, types.float64, types.int64, types.int64)

    def codegen(context, builder, signature, arguments):
        f, self_, t_, h_, u_, y_ = arguments
        kind = ir.FunctionType(_I32, [_VOID, _F64, _F64, _VOID, _VOID])
        pointers = [builder.inttoptr(value, _VOID) for value in (self_, u_, y_)]
        target = builder.inttoptr(f, kind.as_pointer())
        return builder.call(target, [pointers[0], t_, h_, pointers[1], pointers[2]])

    return signature, codegen


@intrinsic
def address_of(typingctx, pointer):
    """The address (int64) behind an argument of a compiled step that is a pointer or a record."""

    def codegen(context, builder, signature, arguments):
        return builder.ptrtoint(arguments[0], _I64)

    return types.int64(pointer), codegen


def pointer_to(item: types.Type) -> Any:
    """A compiled function that makes a pointer to `item` of an address; `numba.carray` makes it an array."""
    pointer = types.CPointer(item)

    @intrinsic
    def at(typingctx, address):
        def codegen(context, builder, signature, arguments):
            return builder.inttoptr(arguments[0], context.get_value_type(pointer))

        return pointer(types.int64), codegen

    return at


doubles_at = pointer_to(types.float64)
bytes_at = pointer_to(types.uint8)
integers_at = pointer_to(types.uint64)
"""Unsigned: an index read from it is never negative, which saves a check."""


@intrinsic
def copy_doubles(typingctx, to, source, count):
    """Copy `count` doubles from address `source` to address `to`, which do not overlap.

    As a loop it would be unrolled for arrays far longer than what components exchange.
    """

    def codegen(context, builder, signature, arguments):
        to_, source_, count_ = arguments
        kind = ir.FunctionType(_VOID, [_VOID, _VOID, _I64])
        memcpy = cgutils.get_or_insert_function(builder.module, kind, "memcpy")
        size = builder.shl(count_, ir.Constant(_I64, 3))
        builder.call(memcpy, [builder.inttoptr(to_, _VOID), builder.inttoptr(source_, _VOID), size])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), codegen


@intrinsic
def clock_cycles(typingctx):
    """The processor's cycle counter; differences are proportional to time."""

    def codegen(context, builder, signature, arguments):
        counter = builder.module.declare_intrinsic("llvm.readcyclecounter", fnty=ir.FunctionType(_I64, []))
        return builder.call(counter, [])

    return types.int64(), codegen
