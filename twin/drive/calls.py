"""FMI functions, called by address: one compiled caller for each signature."""

from twin.compiled.function import c, intrinsic, ir, types


@intrinsic
def access_2(typingctx, function, instance, references, count, values):
    """`fmi2Status fmi2SetX|fmi2GetX(c, const fmi2ValueReference vr[], size_t nvr, X value[])`.

    FMI 1.0's have the same signature, and so do fmi3SetClock and fmi3GetClock.
    """

    def codegen(context, builder, signature, arguments):
        f, it, vr, n, value = arguments
        kind = ir.FunctionType(c.i32, [c.pointer, c.pointer, c.i64, c.pointer])
        it, vr, value = (builder.inttoptr(x, c.pointer) for x in (it, vr, value))
        return builder.call(builder.inttoptr(f, kind.as_pointer()), [it, vr, n, value])

    return types.int32(types.int64, types.int64, types.int64, types.int64, types.int64), codegen


@intrinsic
def access_3(typingctx, function, instance, references, count, values, value_count):
    """`fmi3Status fmi3SetX|fmi3GetX(instance, const vr[], size_t nvr, X value[], size_t nValues)`."""

    def codegen(context, builder, signature, arguments):
        f, it, vr, n, value, m = arguments
        kind = ir.FunctionType(c.i32, [c.pointer, c.pointer, c.i64, c.pointer, c.i64])
        it, vr, value = (builder.inttoptr(x, c.pointer) for x in (it, vr, value))
        return builder.call(builder.inttoptr(f, kind.as_pointer()), [it, vr, n, value, m])

    return types.int32(types.int64, types.int64, types.int64, types.int64, types.int64, types.int64), codegen


@intrinsic
def do_step_2(typingctx, function, instance, t, h, final):
    """`fmi2Status fmi2DoStep(c, t, h, final)`; `final`: no state will ever be restored to a time before `t`.

    In FMI 1.0 the last argument is a char that says that the step is a new one; it is passed in the same way.
    """

    def codegen(context, builder, signature, arguments):
        f, it, t_, h_, final_ = arguments
        kind = ir.FunctionType(c.i32, [c.pointer, c.f64, c.f64, c.i32])
        final_ = builder.trunc(final_, c.i32)
        return builder.call(builder.inttoptr(f, kind.as_pointer()), [builder.inttoptr(it, c.pointer), t_, h_, final_])

    return types.int32(types.int64, types.int64, types.float64, types.float64, types.int64), codegen


@intrinsic
def do_step_3(typingctx, function, instance, t, h, final, returned):
    """`fmi3Status fmi3DoStep(instance, t, h, final, &event, &terminate, &early, &lastTime)`.

    `returned` is the address of 16 bytes for what comes back: lastTime, then the three flags, one byte each.
    """

    def codegen(context, builder, signature, arguments):
        f, it, t_, h_, final_, returned_ = arguments
        kind = ir.FunctionType(c.i32, [c.pointer, c.f64, c.f64, c.i8, c.pointer, c.pointer, c.pointer, c.pointer])
        places = [builder.inttoptr(builder.add(returned_, c.i64(i)), c.pointer) for i in (8, 9, 10, 0)]
        target = builder.inttoptr(f, kind.as_pointer())
        return builder.call(target, [builder.inttoptr(it, c.pointer), t_, h_, builder.trunc(final_, c.i8), *places])

    return types.int32(types.int64, types.int64, types.float64, types.float64, types.int64, types.int64), codegen


@intrinsic
def access_pairs(typingctx, function, instance, references, count, first, second):
    """`fmi2Status fmi2SetRealInputDerivatives(c, const vr[], size_t nvr, const int order[], const double value[])`.

    fmi3GetIntervalDecimal has the same signature: intervals, then qualifiers.
    """

    def codegen(context, builder, signature, arguments):
        f, it, vr, n, a, b = arguments
        kind = ir.FunctionType(c.i32, [c.pointer, c.pointer, c.i64, c.pointer, c.pointer])
        it, vr, a, b = (builder.inttoptr(x, c.pointer) for x in (it, vr, a, b))
        return builder.call(builder.inttoptr(f, kind.as_pointer()), [it, vr, n, a, b])

    return types.int32(*[types.int64] * 6), codegen


@intrinsic
def ask_status(typingctx, function, instance, kind, value):
    """`fmi2Status fmi2GetRealStatus|fmi2GetBooleanStatus(c, const fmi2StatusKind s, X *value)`."""

    def codegen(context, builder, signature, arguments):
        f, it, s, place = arguments
        kind = ir.FunctionType(c.i32, [c.pointer, c.i32, c.pointer])
        it, place = (builder.inttoptr(x, c.pointer) for x in (it, place))
        return builder.call(builder.inttoptr(f, kind.as_pointer()), [it, builder.trunc(s, c.i32), place])

    return types.int32(*[types.int64] * 4), codegen


@intrinsic
def enter(typingctx, function, instance):
    """`fmi3Status fmi3EnterEventMode|fmi3EnterStepMode(instance)`."""

    def codegen(context, builder, signature, arguments):
        f, it = arguments
        kind = ir.FunctionType(c.i32, [c.pointer])
        return builder.call(builder.inttoptr(f, kind.as_pointer()), [builder.inttoptr(it, c.pointer)])

    return types.int32(types.int64, types.int64), codegen


@intrinsic
def update_states(typingctx, function, instance, returned):
    """`fmi3Status fmi3UpdateDiscreteStates(instance, &update, &terminate, &nominals, &values, &defined, &nextTime)`.

    `returned` is the address of 16 bytes for what comes back: nextTime, then the five flags, one byte each.
    """

    def codegen(context, builder, signature, arguments):
        f, it, returned_ = arguments
        kind = ir.FunctionType(c.i32, [c.pointer] * 7)
        places = [builder.inttoptr(builder.add(returned_, c.i64(i)), c.pointer) for i in (8, 9, 10, 11, 12, 0)]
        target = builder.inttoptr(f, kind.as_pointer())
        return builder.call(target, [builder.inttoptr(it, c.pointer), *places])

    return types.int32(types.int64, types.int64, types.int64), codegen
