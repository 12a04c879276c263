"""Functions that C can call, as machine code: taken from the store, or compiled and kept there."""

import ctypes
from collections.abc import Callable, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from twin.compiled import store
from twin.compiled.function import Function, types

Kind = str | np.dtype
"""Of what a function takes or returns: a key of `_KINDS`, or a record's dtype, which it takes by its address."""

_KINDS: dict[str, tuple[str, str, Any]] = {
    "int": ("int64", "i64", ctypes.c_int64),
    "int32": ("int32", "i32", ctypes.c_int32),
    "byte": ("uint8", "i8", ctypes.c_uint8),
    "double": ("float64", "double", ctypes.c_double),
    "pointer": ("voidptr", "ptr", ctypes.c_void_p),
    "doubles": ("CPointer(float64)", "ptr", ctypes.c_void_p),
    "integers": ("CPointer(int64)", "ptr", ctypes.c_void_p),
    "bytes": ("CPointer(uint8)", "ptr", ctypes.c_void_p),
    "nothing": ("void", "void", None),
}
"""What numba, LLVM and ctypes call it."""


class Native:
    """A function at an address, compiled or taken from the store when that is asked for.

    Most runs need few of those there are, and compiling takes seconds.

    Args:
        returns, takes: kinds; no record is returned.
        function: its source. Dividing by zero gives NaN or infinity there, and an exception is lost.
    """

    def __init__(self, returns: str, takes: Sequence[Kind], function: Callable):
        self.returns, self.takes, self.function = returns, tuple(takes), function

    @cached_property
    def address(self) -> int:
        """Where the machine code is."""
        try:
            name = store.name_of(self.function, repr((self.returns, [_told(kind) for kind in self.takes])))
        except store.Unnamed:
            return self._of_numba()
        return store.load(name) or self._made(name)

    @property
    def signature(self) -> Any:
        """Its types as numba has them."""
        return _of_numba(self.returns)(*map(_of_numba, self.takes))

    @cached_property
    def called(self) -> Callable:
        """It, for Python, where pointers are numbers."""
        kinds = [ctypes.c_void_p if isinstance(kind, np.dtype) else _KINDS[kind][2] for kind in self.takes]
        return ctypes.CFUNCTYPE(_KINDS[self.returns][2], *kinds)(self.address)

    def _made(self, name: str) -> int:
        from twin.compiled.emission import bare, callable_by_c, module_of

        module, foreign = bare(
            callable_by_c(module_of(self.signature, self.function, name), _KINDS[self.returns][1]), store.machine()
        )
        return self._of_numba() if foreign else store.keep(name, store.machine().emit_object(module))

    def _of_numba(self) -> int:
        from numba import cfunc

        self._kept = cfunc(self.signature, cache=True, error_model="numpy")(self.function)
        return int(self._kept.address)


class Entry(Function):
    """A compiled function that Python enters by its address, without numba, and compiled functions call like others.

    Args:
        returns, takes, function: as of `Native`.
    """

    def __init__(self, returns: str, takes: Sequence[Kind], function: Callable):
        super().__init__(function, cache=True, error_model="numpy")
        self.native = Native(returns, takes, function)

    def __call__(self, *arguments: Any) -> Any:
        """For a pointer an array may be given, contiguous and of the right kind."""
        return self.native.called(*[a.ctypes.data if isinstance(a, np.ndarray) else a for a in arguments])


def entry(returns: str, *takes: Kind) -> Callable[[Callable], Any]:
    """Decorator: `Entry`. The interpreter's lock is free while it runs."""
    return lambda function: Entry(returns, takes, function)


def _told(kind: Kind) -> str:
    return f"{kind.descr} {kind.itemsize}" if isinstance(kind, np.dtype) else kind


def _of_numba(kind: Kind) -> Any:
    from numba import from_dtype

    if isinstance(kind, np.dtype):
        return from_dtype(kind)
    name, _, item = _KINDS[kind][0].rstrip(")").partition("(")
    found = getattr(types, name)
    return found(getattr(types, item)) if item else found
