"""FMI functions, called by address: one compiled caller for each signature."""

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

_I8, _I32, _I64, _F64 = ir.IntType(8), ir.IntType(32), ir.IntType(64), ir.DoubleType()
_VOID = ir.IntType(8).as_pointer()


@intrinsic
def access_2(typingctx, function, instance, references, count, values):
    """`fmi2Status fmi2SetX|fmi2GetX(c, const fmi2ValueReference vr[], size_t nvr, X value[])`.

    FMI 1.0's have the same signature, and so do fmi3SetClock and fmi3GetClock.
    """

    def codegen(context, builder, signature, arguments):
        f, c, vr, n, value = arguments
        kind = ir.FunctionType(_I32, [_VOID, _VOID, _I64, _VOID])
        c, vr, value = (builder.inttoptr(x, _VOID) for x in (c, vr, value))
        return builder.call(builder.inttoptr(f, kind.as_pointer()), [c, vr, n, value])

    return types.int32(types.int64, types.int64, types.int64, types.int64, types.int64), codegen


@intrinsic
def access_3(typingctx, function, instance, references, count, values, value_count):
    """`fmi3Status fmi3SetX|fmi3GetX(instance, const vr[], size_t nvr, X value[], size_t nValues)`."""

    def codegen(context, builder, signature, arguments):
        f, c, vr, n, value, m = arguments
        kind = ir.FunctionType(_I32, [_VOID, _VOID, _I64, _VOID, _I64])
        c, vr, value = (builder.inttoptr(x, _VOID) for x in (c, vr, value))
        return builder.call(builder.inttoptr(f, kind.as_pointer()), [c, vr, n, value, m])

    return types.int32(types.int64, types.int64, types.int64, types.int64, types.int64, types.int64), codegen


@intrinsic
def do_step_2(typingctx, function, instance, t, h, final):
    """`fmi2Status fmi2DoStep(c, t, h, final)`; `final`: no state will ever be restored to a time before `t`.

    In FMI 1.0 the last argument is a char that says that the step is a new one; it is passed in the same way.
    """

    def codegen(context, builder, signature, arguments):
        f, c, t_, h_, final_ = arguments
        kind = ir.FunctionType(_I32, [_VOID, _F64, _F64, _I32])
        final_ = builder.trunc(final_, _I32)
        return builder.call(builder.inttoptr(f, kind.as_pointer()), [builder.inttoptr(c, _VOID), t_, h_, final_])

    return types.int32(types.int64, types.int64, types.float64, types.float64, types.int64), codegen


@intrinsic
def do_step_3(typingctx, function, instance, t, h, final, returned):
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


@intrinsic
def access_pairs(typingctx, function, instance, references, count, first, second):
    """`fmi2Status fmi2SetRealInputDerivatives(c, const vr[], size_t nvr, const int order[], const double value[])`.

    fmi3GetIntervalDecimal has the same signature: intervals, then qualifiers.
    """

    def codegen(context, builder, signature, arguments):
        f, c, vr, n, a, b = arguments
        kind = ir.FunctionType(_I32, [_VOID, _VOID, _I64, _VOID, _VOID])
        c, vr, a, b = (builder.inttoptr(x, _VOID) for x in (c, vr, a, b))
        return builder.call(builder.inttoptr(f, kind.as_pointer()), [c, vr, n, a, b])

    return types.int32(*[types.int64] * 6), codegen


@intrinsic
def ask_status(typingctx, function, instance, kind, value):
    """`fmi2Status fmi2GetRealStatus|fmi2GetBooleanStatus(c, const fmi2StatusKind s, X *value)`."""

    def codegen(context, builder, signature, arguments):
        f, c, s, place = arguments
        kind = ir.FunctionType(_I32, [_VOID, _I32, _VOID])
        c, place = (builder.inttoptr(x, _VOID) for x in (c, place))
        return builder.call(builder.inttoptr(f, kind.as_pointer()), [c, builder.trunc(s, _I32), place])

    return types.int32(*[types.int64] * 4), codegen


@intrinsic
def enter(typingctx, function, instance):
    """`fmi3Status fmi3EnterEventMode|fmi3EnterStepMode(instance)`."""

    def codegen(context, builder, signature, arguments):
        f, c = arguments
        kind = ir.FunctionType(_I32, [_VOID])
        return builder.call(builder.inttoptr(f, kind.as_pointer()), [builder.inttoptr(c, _VOID)])

    return types.int32(types.int64, types.int64), codegen


@intrinsic
def update_states(typingctx, function, instance, returned):
    """`fmi3Status fmi3UpdateDiscreteStates(instance, &update, &terminate, &nominals, &values, &defined, &nextTime)`.

    `returned` is the address of 16 bytes for what comes back: nextTime, then the five flags, one byte each.
    """

    def codegen(context, builder, signature, arguments):
        f, c, returned_ = arguments
        kind = ir.FunctionType(_I32, [_VOID] * 7)
        places = [builder.inttoptr(builder.add(returned_, _I64(i)), _VOID) for i in (8, 9, 10, 11, 12, 0)]
        target = builder.inttoptr(f, kind.as_pointer())
        return builder.call(target, [builder.inttoptr(c, _VOID), *places])

    return types.int32(types.int64, types.int64, types.int64), codegen
