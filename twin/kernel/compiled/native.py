"""Compiled functions with a C entry point: loaded from the object store, or compiled and stored there."""

import contextlib
import ctypes
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from typing import Any

import numpy as np

from twin.kernel.compiled import machine, store
from twin.kernel.compiled.function import Function, types
from twin.kernel.compiled.numba_internals import inner_module
from twin.kernel.hooks import HOOKS

Kind = str | np.dtype
"""Type of an argument or result: a key of `_TYPE_NAMES`, or the dtype of a record, which is passed by its address."""

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
"""Names of each type in numba and LLVM, and its ctypes class."""
_under_way: list[None] = []
"""One entry for each compilation in progress; threads may compile at the same time."""


@contextlib.contextmanager
def compiling() -> Iterator[None]:
    """Call the hooks `HOOKS.compiling` before and after the block, which compiles or waits for another compilation."""
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
    """Function with a C address, loaded from the store of compiled code or compiled when the address is first used.

    Most runs need few of the functions, and compiling takes seconds. A record cannot be returned. In compiled code,
    division by zero gives NaN or infinity, and exceptions are lost.
    """

    def __init__(self, returns: str, takes: Sequence[Kind], function: Callable):
        self.returns, self.takes, self.function = returns, tuple(takes), function

    @cached_property
    def address(self) -> int:
        """Address of the function's machine code, which is compiled if it is not in the store."""
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
        """Whether the function's machine code is loaded or in the store, so that nothing has to be compiled."""
        return bool(self.name) and machine.load_object(self.name)

    @property
    def signature(self) -> Any:
        return _numba_type(self.returns)(*map(_numba_type, self.takes))

    @cached_property
    def c_function(self) -> Callable:
        """The compiled function as a callable for Python, with addresses as integers; a call releases the GIL."""
        return self._ctypes_function(ctypes.CFUNCTYPE)

    @cached_property
    def c_function_with_gil(self) -> Callable:
        """The compiled function for Python, called with the GIL held: for calls shorter than a thread switch."""
        return self._ctypes_function(ctypes.PYFUNCTYPE)

    def _ctypes_function(self, make: Callable) -> Callable:
        if not (self.address and self.has_code):
            raise RuntimeError(f"{self.function.__name__} needs more than mathematics: Python cannot enter it")
        kinds = ["pointer" if isinstance(kind, np.dtype) else kind for kind in (self.returns, *self.takes)]
        found: Callable = make(*(_TYPE_NAMES[kind][2] for kind in kinds))(self.address)
        return found

    @cached_property
    def name(self) -> str:
        """Name of the function's files in the store of compiled code; "" if it has no unique name to store it under."""
        kinds = [f"{kind.descr} {kind.itemsize}" if isinstance(kind, np.dtype) else kind for kind in self.takes]
        with contextlib.suppress(store.UnnamedFunction):
            return store.name_of(self.function, f"{self.returns} {kinds} {machine.compiler_versions()}")
        return ""

    def emit_object(self, form: machine.ProcessorForm) -> bytes:
        """Compile the function to object code for a processor form; empty if it imports more than mathematics."""
        returns = _TYPE_NAMES[self.returns][1]
        module = machine.with_c_entry(self.module(self.name), returns)
        made, foreign = machine.strip_module(module, machine.target_machine(form))
        return b"" if foreign else bytes(machine.target_machine(form).emit_object(made))

    def module(self, symbol: str) -> machine.Module:
        """Return the LLVM module of the compiled function, whose C entry point will be called `symbol`.

        It is stored for other functions and processor forms, as numba takes longer than all later stages.
        """
        import zstandard

        file = f"{self.name}.ll" if self.name else ""
        if known := store.stored_code(file) if file else b"":
            inner, _, text = zstandard.decompress(known).decode().partition("\n")
        else:
            inner, text = inner_module(self.signature, self.function)
            if file:
                store.store_file(file, zstandard.compress(f"{inner}\n{text}".encode(), level=1))
        return machine.Module(symbol, inner, text)

    def _compile_with_numba(self) -> int:
        from numba import cfunc

        with compiling():
            self._compiled = cfunc(self.signature, error_model="numpy")(self.function)
        return int(self._compiled.address)


def address_of(array: np.ndarray) -> int:
    """Return the address of the first element of an array.

    `array.ctypes.data` takes four times as long, except for records, as a buffer has to describe their fields.
    """
    if array.dtype.kind == "V":
        return array.ctypes.data
    try:
        return ctypes.addressof(ctypes.c_byte.from_buffer(array))  # type: ignore[arg-type]
    except (TypeError, ValueError, BufferError):
        # the array is read-only, empty or not contiguous
        return array.ctypes.data


class Entry(Function):
    """A compiled function that Python calls without numba (see `entry`), and compiled functions like any other."""

    def __init__(self, returns: str, takes: Sequence[Kind], function: Callable, at_once: bool = False):
        super().__init__(function, cache=True, error_model="numpy")
        self.native, self._at_once = Native(returns, takes, function), at_once

    def __call__(self, *arguments: Any) -> Any:
        """Call the machine code of the function; a pointer argument may be a contiguous array of the right type."""
        called = self.native.c_function_with_gil if self._at_once else self.native.c_function
        return called(*[address_of(a) if isinstance(a, np.ndarray) else a for a in arguments])


def entry(returns: str, *takes: Kind, at_once: bool = False) -> Callable[[Callable], Any]:
    """Decorate a function to be compiled as an `Entry`, with arguments "int", "double" and pointers.

    Calls release the GIL unless `at_once` is set, which is for calls shorter than a switch between threads.
    """
    return lambda function: Entry(returns, takes, function, at_once)


def _numba_type(kind: Kind) -> Any:
    from numba import from_dtype

    if isinstance(kind, np.dtype):
        return from_dtype(kind)
    name, _, item = _TYPE_NAMES[kind][0].rstrip(")").partition("(")
    found = getattr(types, name)
    return found(getattr(types, item)) if item else found
