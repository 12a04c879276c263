"""Saving and restoring an FMU's state by address, to repeat a step (FMI 2.0.4, 2.1.8; FMI 3.0, 2.2.5)."""

import numpy as np
from llvmlite import ir
from numba import types
from numba.extending import intrinsic

from twin.cosim.native import step_function

MEMORY = np.dtype([("instance", "i8"), ("get", "i8"), ("set", "i8"), ("cell", "i8"), ("state", "i8")], align=True)
"""Addresses of instance, fmiNGetFMUState, fmiNSetFMUState and of the field `state`, where the FMU's own pointer is."""

SAVE, RESTORE = 80, 96
"""What a bad status starts with, so that the sentence can name the function."""


@intrinsic
def _call(typingctx, function, instance, state):
    """`fmiStatus fmiGetFMUState(c, FMUState *state)` or `fmiSetFMUState(c, FMUState state)`."""

    def codegen(context, builder, signature, arguments):
        pointer = ir.IntType(8).as_pointer()
        kind = ir.FunctionType(ir.IntType(32), [pointer, pointer])
        f, c, s = arguments
        target = builder.inttoptr(f, kind.as_pointer())
        return builder.call(target, [builder.inttoptr(c, pointer), builder.inttoptr(s, pointer)])

    return types.int32(types.int64, types.int64, types.int64), codegen


@step_function(MEMORY)
def save(m, t, h, u, y):
    status = _call(m.get, m.instance, m.cell)
    return SAVE + status if status > 1 else 0


@step_function(MEMORY)
def restore(m, t, h, u, y):
    status = _call(m.set, m.instance, m.state)
    return RESTORE + status if status > 1 else 0
