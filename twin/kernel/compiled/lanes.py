"""Three numbers side by side in one register: an arithmetic for what is the same for three legs.

In a compiled function `three(a, b, c)` has +, -, *, / with its like and with plain numbers, negation, `math.sqrt`, and
is indexed by 0, 1 and 2. Each of its numbers is rounded as it would be alone: it is faster and never another value. The
register holds four, of which the last is nobody's.
"""

import math
import operator
from functools import cache
from typing import Any

from twin.kernel.compiled.function import Name, c, ir, types
from twin.kernel.compiled.numba_internals import infer


@cache
def _made() -> tuple[Any, Any]:
    """The type made known to numba, and what makes values of it."""
    from numba.extending import intrinsic, lower_builtin, models, register_model

    class Lanes(types.Type):  # type: ignore[misc, name-defined]
        def __init__(self) -> None:
            super().__init__("Lanes")

    register = ir.VectorType(c.f64, 4)
    root = ir.FunctionType(register, [register])
    lanes, number = Lanes(), types.float64

    @register_model(Lanes)
    class Model(models.PrimitiveModel):  # type: ignore[misc]
        def __init__(self, dmm: Any, fe_type: Any):
            super().__init__(dmm, fe_type, register)

    def placed(builder, value, lane, item):
        return builder.insert_element(value, item, c.i32(lane))

    def spread(builder, value, kind):
        if kind is lanes:
            return value
        value = placed(builder, ir.Constant(register, ir.Undefined), 0, value)
        return builder.shuffle_vector(value, value, ir.Constant(ir.VectorType(c.i32, 4), [0, 0, 0, 0]))

    def two(function: Any, instruction: str) -> None:
        def lowered(context, builder, sig, arguments):
            return getattr(builder, instruction)(*map(spread, (builder, builder), arguments, sig.args))

        cases = (lanes, lanes), (lanes, number), (number, lanes)
        infer(function, *((lanes, *case) for case in cases))
        for case in cases:
            lower_builtin(function, *case)(lowered)

    for function, instruction in (
        (operator.add, "fadd"), (operator.sub, "fsub"), (operator.mul, "fmul"), (operator.truediv, "fdiv")
    ):  # fmt: skip
        two(function, instruction)

    infer(operator.neg, (lanes, lanes))

    @lower_builtin(operator.neg, lanes)
    def negated(context, builder, sig, arguments):
        return builder.fneg(arguments[0])

    infer(math.sqrt, (lanes, lanes))

    @lower_builtin(math.sqrt, lanes)
    def rooted(context, builder, sig, arguments):
        return builder.call(builder.module.declare_intrinsic("llvm.sqrt.v4f64", fnty=root), arguments)

    infer(operator.getitem, (number, lanes, types.intp))

    @lower_builtin(operator.getitem, lanes, types.Integer)
    def indexed(context, builder, sig, arguments):
        return builder.extract_element(*arguments)

    @intrinsic
    def with_lane(typingctx, value, k, item):
        def codegen(context, builder, sig, arguments):
            value, k, item = arguments
            return builder.insert_element(value, item, k)

        return lanes(lanes, types.intp, number), codegen

    @intrinsic
    def three(typingctx, a, b, c):
        def codegen(context, builder, sig, arguments):
            value = ir.Constant(register, ir.Undefined)
            for k, item in enumerate((*arguments, arguments[-1])):
                value = placed(builder, value, k, item)
            return value

        return lanes(number, number, number), codegen

    return three, with_lane


three: Any = Name(lambda: _made()[0])
"""Three numbers, see above."""
with_lane: Any = Name(lambda: _made()[1])
"""`with_lane(lanes, k, number)`: the lanes with another number k."""
