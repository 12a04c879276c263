"""Calls by address: what lets one compiled loop step components that it has never seen.

Addresses travel as int64 run-time values, so compiled callers are kept across processes although every process loads
its libraries elsewhere.
"""

from collections.abc import Callable

import numpy as np

from twin.kernel.compiled.function import c, intrinsic, ir, pointer_to, types
from twin.kernel.compiled.native import Kind, Native
from twin.kernel.cosim.port import Port, port_record


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
