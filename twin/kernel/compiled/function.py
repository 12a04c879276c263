"""The names that source of compiled functions is written with; numba is imported when something has to be compiled.

Importing numba takes as long as the rest of a run of Fig. 4, and what a run needs is kept as machine code (`store`). So
`njit`, `carray` and `intrinsic` stand here as names that numba knows how to read: where it finds one of these objects
in the source of a function, it asks for its type, and only then there is something of numba's behind it.
"""

import importlib
from collections.abc import Callable
from functools import cached_property, update_wrapper
from typing import Any

import numpy as np

from twin.kernel.compiled.numba_internals import Typed, refresh


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


class OnlyCompiled(TypeError):
    """Source that Python cannot run: it calls something that machine code alone has."""


class Name(Typed):
    """Something that compiled functions call, made when numba meets it for the first time.

    Args:
        make: it.
    """

    def __init__(self, make: Callable[[], Any]):
        self._make = make

    @cached_property
    def made(self) -> Any:  # type: ignore[override]
        """What numba works with."""
        made = self._make()
        # numba may be in the middle of the compilation of a function that calls it
        refresh()
        return made

    def __call__(self, *arguments: Any) -> Any:
        raise OnlyCompiled("a name of compiled code, called from Python")


class Function(Name):
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
            return self.compiled(*arguments)
        except OnlyCompiled as missing:
            try:
                return self.compiled(*arguments)
            except Exception as problem:
                # what it takes or gives is nothing for Python, but whoever called it may be
                raise missing from problem

    @cached_property
    def compiled(self) -> Callable:
        """It as machine code that takes what Python has, compiled anew by each process: for trials."""
        options = {**self.options, "cache": False}
        made: Callable = importlib.import_module("numba").njit(**options)(self.__wrapped__)
        return made

    def __getattr__(self, name: str) -> Any:
        # of numba's dispatcher, by which it knows what to inline; what any object may be asked for is not there
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.made, name)


def njit(**options: Any) -> Callable[[Callable], Any]:
    """Decorator: compile a function when it is called, options as of `numba.njit`."""
    return lambda function: Function(function, **options)


def intrinsic(function: Callable) -> Any:
    """Decorator: `numba.extending.intrinsic`."""
    return Name(lambda: importlib.import_module("numba.extending").intrinsic(function))


carray: Any = Name(lambda: importlib.import_module("numba").carray)
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

    return Name(make)
