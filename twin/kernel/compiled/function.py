"""Decorators and names for the source of compiled functions; numba is imported only to compile.

Importing numba takes as long as the rest of a run of Fig. 4, and functions that a run needs are stored as machine code
(`store`). `njit`, `carray` and `intrinsic` are therefore placeholders: numba asks for their type when it finds them in
the source of a function, and only then the numba object is created.
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
    """Proxy of a Python module that is imported on first access to an attribute."""

    def __init__(self, name: str):
        self._name = name

    def __getattr__(self, name: str) -> Any:
        return getattr(importlib.import_module(self._name), name)


ir: Any = _Module("llvmlite.ir")
types: Any = _Module("numba.types")


class _Layout:
    """LLVM types as attributes: i8, i32, i64, f64, pointer."""

    def __getattr__(self, name: str) -> Any:
        if name == "pointer":
            return self.i8.as_pointer()
        return ir.DoubleType() if name == "f64" else ir.IntType(int(name.removeprefix("i")))


c = _Layout()


class CompiledOnlyError(TypeError):
    """Error that a function cannot run in Python, as it calls a function that exists only in compiled code."""


class LazyObject(NumbaObject):
    """Placeholder for a numba object, created when numba first compiles code that uses it."""

    def __init__(self, make: Callable[[], Any]):
        self._make = make

    @cached_property
    def numba_object(self) -> Any:  # type: ignore[override]
        made = self._make()
        # the access may happen while numba compiles a calling function
        refresh()
        return made

    def __call__(self, *arguments: Any) -> Any:
        raise CompiledOnlyError("a name of compiled code, called from Python")


class Function(LazyObject):
    """Function that compiled code calls as machine code, while Python runs its source.

    No command has to wait for numba to compute one number. Functions that must be fast in Python, or take records, are
    a `native.Entry`. If the source cannot be run by Python, the machine code is called.
    """

    def __init__(self, function: Callable, **options: Any):
        # wrappers for Python objects would double the compile time
        bare = {**options, "cache": False, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        super().__init__(lambda: importlib.import_module("numba").njit(**bare)(function))
        self.options = options
        update_wrapper(self, function)

    def __call__(self, *arguments: Any) -> Any:
        try:
            with np.errstate(all="ignore"):
                return self.__wrapped__(*arguments)
        except (ArithmeticError, ValueError):
            # compiled code returns infinity or NaN where Python's mathematics raises
            return self.dispatcher(*arguments)
        except CompiledOnlyError as missing:
            try:
                return self.dispatcher(*arguments)
            except Exception as problem:
                # the types of its arguments or result may not exist in Python, so the first error is the relevant one
                raise missing from problem

    @cached_property
    def dispatcher(self) -> Callable:
        """The function compiled by numba's `njit`, for calls with Python objects; compiled again in each process."""
        options = {**self.options, "cache": False}
        made: Callable = importlib.import_module("numba").njit(**options)(self.__wrapped__)
        return made

    def __getattr__(self, name: str) -> Any:
        # numba reads attributes of its dispatcher to decide on inlining; special names must not be forwarded
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.numba_object, name)


def njit(**options: Any) -> Callable[[Callable], Any]:
    """Decorate a function to be compiled on its first call, with the options of `numba.njit`."""
    return lambda function: Function(function, **options)


def intrinsic(function: Callable) -> Any:
    """Decorate a function like `numba.extending.intrinsic`, but with numba imported on first use."""
    return LazyObject(lambda: importlib.import_module("numba.extending").intrinsic(function))


carray: Any = LazyObject(lambda: importlib.import_module("numba").carray)
"""`numba.carray`: view the memory at a pointer as an array."""


def pointer_to(item: Any) -> Any:
    """Create a compiled function that converts an address to a pointer to elements of dtype `item`, for `carray`."""

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
    """Register a SIMD register of four doubles, `Lanes`, as a numba type; return `three` and `with_lane`."""
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
"""`three(a, b, c)`: the lanes (a, b, c, c), a SIMD register of four doubles."""
with_lane: Any = LazyObject(lambda: _lane_functions()[1])
"""`with_lane(lanes, k, number)`: a copy of the lanes with lane k replaced."""


@intrinsic
def store_number(typingctx, address, value):
    """Write the number `value`, with the width of its type, to a memory address that need not be aligned."""

    def codegen(context, builder, signature, arguments):
        to, number = arguments
        written = builder.store(number, builder.inttoptr(to, number.type.as_pointer()))
        written.align = 1
        return context.get_dummy_value()

    return types.void(types.int64, value), codegen


@intrinsic
def copy(typingctx, to, source, count):
    """Copy `count` bytes of memory from address `source` to address `to`; the ranges must not overlap.

    Calls memcpy, as the compiler would unroll a loop far beyond the typical count.
    """

    def codegen(context, builder, signature, arguments):
        to_, source_, count_ = arguments
        kind = ir.FunctionType(c.pointer, [c.pointer, c.pointer, c.i64])
        memcpy = declare_function(builder.module, kind, "memcpy")
        builder.call(memcpy, [builder.inttoptr(to_, c.pointer), builder.inttoptr(source_, c.pointer), count_])
        return context.get_dummy_value()

    return types.void(types.int64, types.int64, types.int64), codegen
