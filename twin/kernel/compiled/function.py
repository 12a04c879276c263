"""The names that source of compiled functions is written with; numba is imported when something has to be compiled.

Importing numba takes as long as the rest of a run of Fig. 4, and what a run needs is kept as machine code (`store`). So
`njit`, `carray` and `intrinsic` stand here as names that numba knows how to read: where it finds one of these objects
in the source of a function, it asks for its type, and only then there is something of numba's behind it.
"""

import importlib
import math
import operator
from collections.abc import Callable
from functools import cache, cached_property, update_wrapper
from typing import Any

import numpy as np

from twin.kernel.compiled.numba_internals import NumbaObject, declare_function, infer, refresh


class _Module:
    """A module that is imported when something of it is asked for."""

    def __init__(self, name: str):
        self._name = name

    def __getattr__(self, name: str) -> Any:
        return getattr(importlib.import_module(self._name), name)


ir: Any = _Module("llvmlite.ir")
types: Any = _Module("numba.types")


class _Layout:
    """Types of C as LLVM calls them: i8, i32, i64, f64, pointer."""

    def __getattr__(self, name: str) -> Any:
        if name == "pointer":
            return self.i8.as_pointer()
        return ir.DoubleType() if name == "f64" else ir.IntType(int(name.removeprefix("i")))


c = _Layout()


class CompiledOnlyError(TypeError):
    """Source that Python cannot run: it calls something that machine code alone has."""


class LazyObject(NumbaObject):
    """Something that compiled functions call, made when numba meets it for the first time.

    Args:
        make: it.
    """

    def __init__(self, make: Callable[[], Any]):
        self._make = make

    @cached_property
    def numba_object(self) -> Any:  # type: ignore[override]
        """What numba works with."""
        made = self._make()
        # numba may be in the middle of the compilation of a function that calls it
        refresh()
        return made

    def __call__(self, *arguments: Any) -> Any:
        raise CompiledOnlyError("a name of compiled code, called from Python")


class Function(LazyObject):
    """A compiled function: what is compiled calls it as such, Python calls its source.

    So no command waits for numba because of one number; what has to be fast in Python, or takes records, is a
    `native.Entry`. Where its source cannot answer, the machine code does.

    Args:
        function: its source.
        options: of numba's `njit`.
    """

    def __init__(self, function: Callable, **options: Any):
        # what takes and gives objects of Python would take half of the time to compile
        bare = {**options, "cache": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        super().__init__(lambda: importlib.import_module("numba").njit(**bare)(function))
        self.options = options
        update_wrapper(self, function)

    def __call__(self, *arguments: Any) -> Any:
        try:
            with np.errstate(all="ignore"):
                return self.__wrapped__(*arguments)
        except (ArithmeticError, ValueError):
            # compiled code has infinity and NaN where Python's mathematics raises
            return self.dispatcher(*arguments)
        except CompiledOnlyError as missing:
            try:
                return self.dispatcher(*arguments)
            except Exception as problem:
                # what it takes or gives is nothing for Python, but its caller may be
                raise missing from problem

    @cached_property
    def dispatcher(self) -> Callable:
        """It as machine code that takes what Python has, compiled anew by each process: for trials."""
        options = {**self.options, "cache": False}
        made: Callable = importlib.import_module("numba").njit(**options)(self.__wrapped__)
        return made

    def __getattr__(self, name: str) -> Any:
        # of numba's dispatcher, by which it knows what to inline; what any object may be asked for is not there
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.numba_object, name)


def njit(**options: Any) -> Callable[[Callable], Any]:
    """Decorator: compile a function when it is called, options as of `numba.njit`."""
    return lambda function: Function(function, **options)


def intrinsic(function: Callable) -> Any:
    """Decorator: `numba.extending.intrinsic`."""
    return LazyObject(lambda: importlib.import_module("numba.extending").intrinsic(function))


carray: Any = LazyObject(lambda: importlib.import_module("numba").carray)
"""`numba.carray`: the array at a pointer."""


def pointer_to(item: Any) -> Any:
    """A compiled function that makes a pointer to `item`, a dtype, of an address; `carray` makes it an array."""

    def make() -> Any:
        from numba import from_dtype
        from numba.extending import intrinsic

        pointer = types.CPointer(from_dtype(np.dtype(item)))

        def at(typingctx, address):
            def codegen(context, builder, signature, arguments):
                return builder.inttoptr(arguments[0], context.get_value_type(pointer))

            return pointer(types.int64), codegen

        return intrinsic(at)

    return LazyObject(make)


@cache
def _lane_functions() -> tuple[Any, Any]:
    """The type made known to numba, and what makes values of it."""
    from numba.extending import intrinsic, lower_builtin, models, register_model

    class Lanes(types.Type):  # type: ignore[misc, name-defined]
        def __init__(self) -> None:
            super().__init__("Lanes")

    register = ir.VectorType(c.f64, 4)
    root = ir.FunctionType(register, [register])
    lanes, number = Lanes(), types.float64

    @register_model(Lanes)
    class LaneModel(models.PrimitiveModel):  # type: ignore[misc]
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


three: Any = LazyObject(lambda: _lane_functions()[0])
"""Three numbers, see above."""
with_lane: Any = LazyObject(lambda: _lane_functions()[1])
"""`with_lane(lanes, k, number)`: the lanes with another number k."""


@intrinsic
def store_number(typingctx, address, value):
    """Write the number `value`, as wide as its type is, to an address that may be no multiple of that."""

    def codegen(context, builder, signature, arguments):
        to, number = arguments
        written = builder.store(number, builder.inttoptr(to, number.type.as_pointer()))
        written.align = 1
        return context.get_dummy_value()

    return types.void(types.int64, value), codegen


@intrinsic
def copy(typingctx, to, source, count):
    """Copy `count` bytes from address `source` to address `to`, which do not overlap.

    As a loop it would be unrolled for far more than what is copied.
    """

    def codegen(context, builder, signature, arguments):
        to_, source_, count_ = arguments
        kind = ir.FunctionType(c.pointer, [c.pointer, c.pointer, c.i64])
        memcpy = declare_function(builder.module, kind, "memcpy")
        builder.call(memcpy, [builder.inttoptr(to_, c.pointer), builder.inttoptr(source_, c.pointer), count_])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), codegen
