"""One compiled step for every FMI 2.0 and 3.0 co-simulation FMU: set inputs, step, get outputs, all by address.

Variables travel in groups of one FMI type. A group holds where its values stand among the component's inputs or
outputs, how they are scaled (contract value = gain * FMU value + offset), and a buffer of the FMI type.
"""

import numpy as np
from llvmlite import ir
from numba import carray, from_dtype, njit, types
from numba.extending import intrinsic

from twin.cosim.native import address_of, pointer_to, step_function

_I8, _I32, _I64, _F64 = ir.IntType(8), ir.IntType(32), ir.IntType(64), ir.DoubleType()
_VOID = ir.IntType(8).as_pointer()

KINDS = ("Float64", "Float32", "Int8", "UInt8", "Int16", "UInt16", "Int32", "UInt32", "Int64", "UInt64", "Boolean")
"""FMI 3.0 types, a group's `kind` is the index. FMI 2.0's Real is a Float64, its Integer and Boolean are Int32."""

ITEM_SIZES = (8, 4, 1, 1, 2, 2, 4, 4, 8, 8, 1)
"""Bytes of one value of each of `KINDS`."""

_f64, _f32 = pointer_to(types.float64), pointer_to(types.float32)
_i8, _u8, _i16, _u16 = (pointer_to(t) for t in (types.int8, types.uint8, types.int16, types.uint16))
_i32, _u32, _i64, _u64 = (pointer_to(t) for t in (types.int32, types.uint32, types.int64, types.uint64))

GROUP = np.dtype(
    [
        ("kind", "i8"),
        ("access", "i8"),
        ("references", "i8"),
        ("variables", "i8"),
        ("values", "i8"),
        ("slots", "i8"),
        ("gain", "i8"),
        ("offset", "i8"),
        ("buffer", "i8"),
    ],
    align=True,
)
"""A group: index into KINDS; address of fmiNSetType or fmiNGetType; addresses and counts: `variables` value references
(uint32), `values` slots (uint64) into u or y, gains and offsets (float64), and the buffer. Arrays make values exceed
variables."""

MEMORY = np.dtype(
    [
        ("version", "i8"),
        ("instance", "i8"),
        ("do_step", "i8"),
        ("final", "i8"),
        ("inputs", "i8"),
        ("input_groups", "i8"),
        ("outputs", "i8"),
        ("output_groups", "i8"),
        ("returned", "i8"),
    ],
    align=True,
)

SET, DO_STEP, GET, TERMINATE = 16, 32, 48, 64
"""What a bad status starts with, so that the sentence can name the function."""

_groups_at = pointer_to(from_dtype(GROUP))


@intrinsic
def access_2(typingctx, function, instance, references, count, values):
    """`fmi2Status fmi2SetX|fmi2GetX(c, const fmi2ValueReference vr[], size_t nvr, X value[])`."""

    def codegen(context, builder, signature, arguments):
        f, c, vr, n, value = arguments
        kind = ir.FunctionType(_I32, [_VOID, _VOID, _I64, _VOID])
        c, vr, value = (builder.inttoptr(x, _VOID) for x in (c, vr, value))
        return builder.call(builder.inttoptr(f, kind.as_pointer()), [c, vr, n, value])

    return types.int32(types.int64, types.int64, types.int64, types.int64, types.int64), codegen


@intrinsic
def _access_3(typingctx, function, instance, references, count, values, value_count):
    """`fmi3Status fmi3SetX|fmi3GetX(instance, const vr[], size_t nvr, X value[], size_t nValues)`."""

    def codegen(context, builder, signature, arguments):
        f, c, vr, n, value, m = arguments
        kind = ir.FunctionType(_I32, [_VOID, _VOID, _I64, _VOID, _I64])
        c, vr, value = (builder.inttoptr(x, _VOID) for x in (c, vr, value))
        return builder.call(builder.inttoptr(f, kind.as_pointer()), [c, vr, n, value, m])

    return types.int32(types.int64, types.int64, types.int64, types.int64, types.int64, types.int64), codegen


@intrinsic
def do_step_2(typingctx, function, instance, t, h, final):
    """`fmi2Status fmi2DoStep(c, t, h, final)`; `final`: no state will ever be restored to a time before `t`."""

    def codegen(context, builder, signature, arguments):
        f, c, t_, h_, final_ = arguments
        kind = ir.FunctionType(_I32, [_VOID, _F64, _F64, _I32])
        final_ = builder.trunc(final_, _I32)
        return builder.call(builder.inttoptr(f, kind.as_pointer()), [builder.inttoptr(c, _VOID), t_, h_, final_])

    return types.int32(types.int64, types.int64, types.float64, types.float64, types.int64), codegen


@intrinsic
def _do_step_3(typingctx, function, instance, t, h, final, returned):
    """`fmi3Status fmi3DoStep(instance, t, h, final, &event, &terminate, &early, &lastTime)`.

    `returned` is the address of 16 bytes for what comes back: lastTime, then the three flags, one byte each.
    """

    def codegen(context, builder, signature, arguments):
        f, c, t_, h_, final_, returned_ = arguments
        kind = ir.FunctionType(_I32, [_VOID, _F64, _F64, _I8, _VOID, _VOID, _VOID, _VOID])
        places = [builder.inttoptr(builder.add(returned_, _I64(i)), _VOID) for i in (8, 9, 10, 0)]
        target = builder.inttoptr(f, kind.as_pointer())
        return builder.call(target, [builder.inttoptr(c, _VOID), t_, h_, builder.trunc(final_, _I8), *places])

    return types.int32(types.int64, types.int64, types.float64, types.float64, types.int64, types.int64), codegen


@njit(cache=True)
def _store(kind, buffer, j, value):
    """Put `value` at place `j` of a buffer of FMI type `kind`; whole numbers are rounded to the nearest."""
    if kind == 0:
        carray(_f64(buffer), j + 1)[j] = value
    elif kind == 1:
        carray(_f32(buffer), j + 1)[j] = value
    elif kind == 10:
        carray(_u8(buffer), j + 1)[j] = 1 if value > 0.5 else 0
    else:
        whole = np.int64(np.floor(value + 0.5))
        if kind == 2:
            carray(_i8(buffer), j + 1)[j] = whole
        elif kind == 3:
            carray(_u8(buffer), j + 1)[j] = whole
        elif kind == 4:
            carray(_i16(buffer), j + 1)[j] = whole
        elif kind == 5:
            carray(_u16(buffer), j + 1)[j] = whole
        elif kind == 6:
            carray(_i32(buffer), j + 1)[j] = whole
        elif kind == 7:
            carray(_u32(buffer), j + 1)[j] = whole
        elif kind == 8:
            carray(_i64(buffer), j + 1)[j] = whole
        else:
            carray(_u64(buffer), j + 1)[j] = whole


@njit(cache=True)
def _load(kind, buffer, j):
    """The value at place `j` of a buffer of FMI type `kind`."""
    if kind == 0:
        return carray(_f64(buffer), j + 1)[j]
    if kind == 1:
        return np.float64(carray(_f32(buffer), j + 1)[j])
    if kind == 2:
        return np.float64(carray(_i8(buffer), j + 1)[j])
    if kind == 3 or kind == 10:
        return np.float64(carray(_u8(buffer), j + 1)[j])
    if kind == 4:
        return np.float64(carray(_i16(buffer), j + 1)[j])
    if kind == 5:
        return np.float64(carray(_u16(buffer), j + 1)[j])
    if kind == 6:
        return np.float64(carray(_i32(buffer), j + 1)[j])
    if kind == 7:
        return np.float64(carray(_u32(buffer), j + 1)[j])
    if kind == 8:
        return np.float64(carray(_i64(buffer), j + 1)[j])
    return np.float64(carray(_u64(buffer), j + 1)[j])


@njit(cache=True)
def _access(version, instance, g):
    if version == 2:
        return access_2(g.access, instance, g.references, g.variables, g.buffer)
    return _access_3(g.access, instance, g.references, g.variables, g.buffer, g.values)


@njit(cache=True)
def set_inputs(version, instance, table, count, u):
    """Set the inputs of the `count` groups at `table` from the doubles at `u`; 0, or a bad status."""
    groups = carray(_groups_at(table), count)
    for i in range(count):
        g = groups[i]
        slots, gain, offset = (
            carray(_u64(g.slots), g.values),
            carray(_f64(g.gain), g.values),
            carray(_f64(g.offset), g.values),
        )
        for j in range(g.values):
            _store(g.kind, g.buffer, j, (carray(_f64(u), slots[j] + 1)[slots[j]] - offset[j]) / gain[j])
        status = _access(version, instance, g)
        if status > 1:
            return SET + status
    return 0


@njit(cache=True)
def take_outputs(version, instance, table, count, y):
    """Read the outputs of the `count` groups at `table` into the doubles at `y`; 0, or a bad status."""
    groups = carray(_groups_at(table), count)
    for i in range(count):
        g = groups[i]
        status = _access(version, instance, g)
        if status > 1:
            return GET + status
        slots, gain, offset = (
            carray(_u64(g.slots), g.values),
            carray(_f64(g.gain), g.values),
            carray(_f64(g.offset), g.values),
        )
        for j in range(g.values):
            carray(_f64(y), slots[j] + 1)[slots[j]] = gain[j] * _load(g.kind, g.buffer, j) + offset[j]
    return 0


@step_function(MEMORY)
def step(m, t, h, u, y):
    status = set_inputs(m.version, m.instance, m.input_groups, m.inputs, address_of(u))
    if status != 0:
        return status
    if m.version == 2:
        status = do_step_2(m.do_step, m.instance, t, h, m.final)
    else:
        status = _do_step_3(m.do_step, m.instance, t, h, m.final, m.returned)
        if status <= 1 and carray(_u8(m.returned), 16)[9]:
            return TERMINATE
    if status > 1:
        return DO_STEP + status
    return take_outputs(m.version, m.instance, m.output_groups, m.outputs, address_of(y))
