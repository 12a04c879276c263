"""One compiled step for every FMI 2.0 co-simulation drive: set inputs, step, get outputs, all by address."""

import numpy as np
from llvmlite import ir
from numba import carray, types
from numba.extending import intrinsic

from twin.cosim.native import address_of, step_function

_I32, _I64, _F64, _VOID = ir.IntType(32), ir.IntType(64), ir.DoubleType(), ir.IntType(8).as_pointer()

MEMORY = np.dtype(
    [
        ("instance", "i8"),
        ("set_real", "i8"),
        ("do_step", "i8"),
        ("get_real", "i8"),
        ("inputs", "i8"),
        ("input_references", "i8"),
        ("outputs", "i8"),
        ("output_references", "i8"),
        ("theta_m_offset", "f8"),
    ],
    align=True,
)

SET_REAL, DO_STEP, GET_REAL = 16, 32, 48
"""What a bad status starts with, so that the sentence can name the function."""

FUNCTIONS = {SET_REAL: "fmi2SetReal", DO_STEP: "fmi2DoStep", GET_REAL: "fmi2GetReal"}
STATUSES = {2: "fmi2Discard", 3: "fmi2Error", 4: "fmi2Fatal", 5: "fmi2Pending"}


@intrinsic
def _access_real(typingctx, function, instance, references, count, values):
    """`fmi2Status fmi2SetReal|fmi2GetReal(c, const unsigned vr[], size_t nvr, double value[])` by address."""

    def codegen(context, builder, signature, arguments):
        f, instance_, references_, count_, values_ = arguments
        kind = ir.FunctionType(_I32, [_VOID, _VOID, _I64, _VOID])
        pointers = [builder.inttoptr(value, _VOID) for value in (instance_, references_, values_)]
        target = builder.inttoptr(f, kind.as_pointer())
        return builder.call(target, [pointers[0], pointers[1], count_, pointers[2]])

    return types.int32(types.int64, types.int64, types.int64, types.int64, types.int64), codegen


@intrinsic
def _do_step(typingctx, function, instance, t, h):
    """`fmi2Status fmi2DoStep(c, t, h, fmi2True)` by address; no state is ever restored behind `t`."""

    def codegen(context, builder, signature, arguments):
        f, instance_, t_, h_ = arguments
        kind = ir.FunctionType(_I32, [_VOID, _F64, _F64, _I32])
        target = builder.inttoptr(f, kind.as_pointer())
        return builder.call(target, [builder.inttoptr(instance_, _VOID), t_, h_, _I32(1)])

    return types.int32(types.int64, types.int64, types.float64, types.float64), codegen


@step_function(MEMORY)
def step(self, t, h, u, y):
    m = carray(self, 1)[0]
    status = _access_real(m.set_real, m.instance, m.input_references, m.inputs, address_of(u))
    if status > 1:
        return SET_REAL + status
    status = _do_step(m.do_step, m.instance, t, h)
    if status > 1:
        return DO_STEP + status
    status = _access_real(m.get_real, m.instance, m.output_references, m.outputs, address_of(y))
    if status > 1:
        return GET_REAL + status
    carray(y, 1)[0] += m.theta_m_offset
    return 0
