"""Functions that C can call, as machine code: taken from the store, or compiled and kept there."""

import contextlib
import ctypes
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from twin.kernel.compiled import machine, store
from twin.kernel.compiled.function import Function, types
from twin.kernel.hooks import HOOKS

if TYPE_CHECKING:
    from twin.kernel.compiled.machine import Module

Kind = str | np.dtype
"""Of what a function takes or returns: a key of `_TYPE_NAMES`, or a record's dtype, which it takes by its address."""

_TYPE_NAMES: dict[str, tuple[str, str, Any]] = {
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


_under_way: list[None] = []
"""One for each of what is being compiled, as threads may compile side by side."""


@contextlib.contextmanager
def compiling() -> Iterator[None]:
    """Around what compiles, or waits for another process that compiles the same."""
    _under_way.append(None)
    if len(_under_way) == 1:
        for hook in HOOKS.compiling:
            hook(True)
    try:
        yield
    finally:
        _under_way.pop()
        if not _under_way:
            for hook in HOOKS.compiling:
                hook(False)


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
        if not self.name:
            return self._compile_with_numba()
        if not self.has_code:
            while HOOKS.before_compiling:
                HOOKS.before_compiling.pop()()
            with compiling(), store.object_lock(self.name):
                code = b"" if self.has_code else self.emit_object(machine.chosen_form())
                if code:
                    machine.store_object(self.name, code)
        return machine.function_address(self.name) if self.has_code else self._compile_with_numba()

    @property
    def has_code(self) -> bool:
        """Whether it need not be compiled any more."""
        return bool(self.name) and machine.load_object(self.name)

    @property
    def signature(self) -> Any:
        """Its types as numba has them."""
        return _numba_type(self.returns)(*map(_numba_type, self.takes))

    @cached_property
    def c_function(self) -> Callable:
        """It, for Python, where addresses are numbers. The interpreter's lock is free meanwhile."""
        return self._ctypes_function(ctypes.CFUNCTYPE)

    @cached_property
    def c_function_with_gil(self) -> Callable:
        """The same, with the interpreter's lock: for what is over before another thread would have taken its turn."""
        return self._ctypes_function(ctypes.PYFUNCTYPE)

    def _ctypes_function(self, make: Callable) -> Callable:
        if not (self.address and self.has_code):
            raise RuntimeError(f"{self.function.__name__} needs more than mathematics: Python cannot enter it")
        kinds = ["pointer" if isinstance(kind, np.dtype) else kind for kind in (self.returns, *self.takes)]
        found: Callable = make(*(_TYPE_NAMES[kind][2] for kind in kinds))(self.address)
        return found

    @cached_property
    def name(self) -> str:
        """Of what is kept of it; "" if nothing can be."""
        kinds = [f"{kind.descr} {kind.itemsize}" if isinstance(kind, np.dtype) else kind for kind in self.takes]
        with contextlib.suppress(store.UnnamedFunction):
            return store.name_of(self.function, f"{self.returns} {kinds} {machine.compiler_versions()}")
        return ""

    def emit_object(self, form: machine.ProcessorForm) -> bytes:
        """Object code of a form; none if it needs more than mathematics."""
        returns = _TYPE_NAMES[self.returns][1]
        module = machine.with_c_entry(self.module(self.name), returns)
        made, foreign = machine.strip_module(module, machine.target_machine(form))
        return b"" if foreign else bytes(machine.target_machine(form).emit_object(made))

    def module(self, symbol: str) -> "Module":
        """As numba leaves it, with a function that shall be called `symbol`.

        It is kept for what it may be built into, and for other forms: numba takes longer than all that comes after it.
        """
        import zstandard

        file = f"{self.name}.ll" if self.name else ""
        known = store.stored_code(file) if file else b""
        if known:
            inner, _, text = zstandard.decompress(known).decode().partition("\n")
            return machine.Module(symbol, inner, text)
        made = machine.module_of(self.signature, self.function, symbol)
        if file:
            store.store_file(file, zstandard.compress(f"{made.inner}\n{made.text}".encode(), level=1))
        return made

    def _compile_with_numba(self) -> int:
        from numba import cfunc

        with compiling():
            self._compiled = cfunc(self.signature, error_model="numpy")(self.function)
        return int(self._compiled.address)


def address_of(array: np.ndarray) -> int:
    """Of the first number of an array. To ask numpy, `array.ctypes.data`, takes four times as long, but not of records:
    a buffer has to describe their fields."""
    if array.dtype.kind == "V":
        return array.ctypes.data
    try:
        return ctypes.addressof(ctypes.c_byte.from_buffer(array))  # type: ignore[arg-type]
    except (TypeError, ValueError, BufferError):
        # it is read only, empty, or has gaps
        return array.ctypes.data


class Entry(Function):
    """A compiled function that Python enters without numba, and that compiled functions call like others.

    Args:
        returns, takes, function: as of `Native`.
        at_once: see `entry`.
    """

    def __init__(self, returns: str, takes: Sequence[Kind], function: Callable, at_once: bool = False):
        super().__init__(function, cache=True, error_model="numpy")
        self.native, self._at_once = Native(returns, takes, function), at_once

    def __call__(self, *arguments: Any) -> Any:
        """For a pointer an array may be given, contiguous and of the right kind."""
        called = self.native.c_function_with_gil if self._at_once else self.native.c_function
        return called(*[address_of(a) if isinstance(a, np.ndarray) else a for a in arguments])


def entry(returns: str, *takes: Kind, at_once: bool = False) -> Callable[[Callable], Any]:
    """Decorator: `Entry`, of kinds "int", "double" and pointers. The interpreter's lock is free while it runs, unless
    `at_once`: it is over before another thread would have taken its turn."""
    return lambda function: Entry(returns, takes, function, at_once)


def _numba_type(kind: Kind) -> Any:
    from numba import from_dtype

    if isinstance(kind, np.dtype):
        return from_dtype(kind)
    name, _, item = _TYPE_NAMES[kind][0].rstrip(")").partition("(")
    found = getattr(types, name)
    return found(getattr(types, item)) if item else found
