"""Saving and restoring an FMU's state by address, to repeat a step (FMI 2.0.4, 2.1.8; FMI 3.0, 2.2.5)."""

import numpy as np

from twin.compiled.function import c, carray, intrinsic, ir, njit, pointer_to, types
from twin.cosim.native import bytes_at, step_function
from twin.drive.status import RESTORE, SAVE

MEMORY = np.dtype(
    [
        ("instance", "i8"),
        ("get", "i8"),
        ("set", "i8"),
        ("cell", "i8"),
        ("state", "i8"),
        ("pieces", "i8"),
        ("piece_table", "i8"),
    ],
    align=True,
)
"""Addresses of instance, fmiNGetFMUState, fmiNSetFMUState and of the field `state`, where the FMU's own pointer is; how
many pieces of our own memory go back with it, and the address of their table."""

PIECE = np.dtype([("array", "i8"), ("copy", "i8"), ("size", "i8")])
"""Addresses of a piece and of its copy, and their bytes."""

_pieces_at = pointer_to(PIECE)


@njit(cache=True)
def _copy(source, target, size):
    from_, to = carray(bytes_at(source), size), carray(bytes_at(target), size)
    for i in range(size):
        to[i] = from_[i]


@intrinsic
def _call(typingctx, function, instance, state):
    """`fmiStatus fmiGetFMUState(c, FMUState *state)` or `fmiSetFMUState(c, FMUState state)`."""

    def codegen(context, builder, signature, arguments):
        kind = ir.FunctionType(c.i32, [c.pointer, c.pointer])
        f, it, s = arguments
        target = builder.inttoptr(f, kind.as_pointer())
        return builder.call(target, [builder.inttoptr(it, c.pointer), builder.inttoptr(s, c.pointer)])

    return types.int32(types.int64, types.int64, types.int64), codegen


@step_function(MEMORY)
def save(m, t, h, u, y):
    status = _call(m.get, m.instance, m.cell)
    pieces = carray(_pieces_at(m.piece_table), m.pieces)
    for i in range(m.pieces):
        _copy(pieces[i].array, pieces[i].copy, pieces[i].size)
    return SAVE + status if status > 1 else 0


@step_function(MEMORY)
def restore(m, t, h, u, y):
    status = _call(m.set, m.instance, m.state)
    pieces = carray(_pieces_at(m.piece_table), m.pieces)
    for i in range(m.pieces):
        _copy(pieces[i].copy, pieces[i].array, pieces[i].size)
    return RESTORE + status if status > 1 else 0
