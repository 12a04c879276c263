"""Machine code of functions kept as object files, which are loaded without numba.

They lie in the folder of this source (`cache`), each with a seal at its end (`seal`), named after the function, what it
was closed over, its types, the processor and the compiler. An object file holds code that asks for nothing but
mathematics; a function whose code needs more, memory of its own say, stays numba's.
"""

import contextlib
import hashlib
import os
from collections.abc import Callable, Iterator
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numpy as np

try:
    import fcntl
except ImportError:
    # Windows, where two processes may make the same file
    fcntl = None  # type: ignore[assignment]

from twin.compiled.cache import is_own, source_digest, use_cache
from twin.compiled.function import Function
from twin.compiled.seal import sealed, unsealed

FOLDER = "objects"
_OWN = "twin."
_COMPILERS = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_OPT")
"""Variables that change what numba makes."""

_loaded: set[str] = set()
"""Names of object files of this process."""


_helpers: list[Callable[[], None]] = []


class Unnamed(Exception):
    """A function whose code cannot be told from that of another one by its name."""


def name_of(function: Callable, kinds: str) -> str:
    """Of the object file of a function of this package.

    Args:
        function: its source.
        kinds: what tells its types.

    Raises:
        Unnamed: it belongs to somebody else, or is closed over something whose value cannot be told.
    """
    if not function.__module__.startswith(_OWN):
        raise Unnamed
    what = hashlib.blake2b(f"{_identity(function)}\0{kinds}\0{_target()}".encode(), digest_size=12).hexdigest()
    return f"{function.__module__.removeprefix(_OWN)}.{function.__name__}-{what}"


def has(name: str) -> bool:
    """Whether there is an object file of that name; its function has an address from now on."""
    if name not in _loaded:
        content = kept(f"{name}.o")
        if content:
            _load(name, content)
    return name in _loaded


def help_with(helper: Callable[[], None]) -> None:
    """Call `helper` before this process compiles for the first time."""
    _helpers.append(helper)


def call_helpers() -> None:
    """Something has to be compiled."""
    while _helpers:
        _helpers.pop()()


@contextlib.contextmanager
def alone(name: str) -> Iterator[None]:
    """Nobody else makes the object file of that name meanwhile."""
    try:
        _folder().mkdir(parents=True, exist_ok=True)
        lock = open(_folder() / f".{name}.lock", "w")  # noqa: SIM115, its end is below
    except OSError:
        # nothing can be kept, so nobody can wait for it
        yield
        return
    with lock:
        if fcntl is not None:
            with contextlib.suppress(OSError):
                fcntl.flock(lock, fcntl.LOCK_EX)
        yield


def take(name: str, content: bytes) -> None:
    """Take a new object file; it is there for other processes too if that is possible."""
    keep(f"{name}.o", content)
    _load(name, content)


def keep(file: str, content: bytes) -> None:
    """Put a file beside the object files, if that is possible."""
    # a full disk, a folder that is gone: the code runs all the same
    with contextlib.suppress(OSError):
        _folder().mkdir(parents=True, exist_ok=True)
        aside = _folder() / f".{file}-{os.getpid()}"
        aside.write_bytes(sealed(content))
        aside.replace(_folder() / file)


def kept(file: str) -> bytes:
    """What was put there under that name; nothing if it is not there, or not as it was written."""
    return unsealed(_folder() / file, _folder())


def address(symbol: str) -> int:
    """Of a function of an object file that is there."""
    return int(_engine().get_function_address(symbol))


@cache
def machine() -> Any:
    """The processor, and code that may lie anywhere in memory."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=llvm.get_host_cpu_name(),
        features=llvm.get_host_cpu_features().flatten(),
        opt=3,
        jit=True,
        reloc="default",
        codemodel="jitdefault",
    )


def _load(name: str, content: bytes) -> None:
    _engine().add_object_file(llvm.ObjectFileRef.from_data(content))
    _engine().finalize_object()
    _loaded.add(name)


@cache
def _engine() -> Any:
    machine()
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine())


@cache
def _folder() -> Path:
    """Where object files are."""
    return use_cache() / FOLDER


@cache
def _target() -> str:
    given = [os.environ.get(name, "") for name in _COMPILERS]
    folder = _folder().parent
    # one of the user's own choice is not named after the source
    given += [] if is_own(folder) else [source_digest(Path(__file__).parents[1])]
    features = llvm.get_host_cpu_features().flatten()
    return repr((version("numba"), llvmlite.__version__, llvm.get_host_cpu_name(), features, given))


def _identity(value: Any) -> str:
    """What tells `value`, a function or what it is closed over, from others within this source.

    Raises:
        Unnamed: nothing does.
    """
    if isinstance(value, Function):
        value = value.__wrapped__
    if value is None or isinstance(value, (bool, int, float, str)):
        return repr(value)
    if isinstance(value, np.dtype):
        return f"{value.descr} {value.itemsize}"
    if isinstance(value, (tuple, list)):
        return f"({', '.join(map(_identity, value))})"
    if callable(value) and hasattr(value, "__code__"):
        closed = [cell.cell_contents for cell in value.__closure__ or ()]
        return f"{value.__module__}.{value.__qualname__}{_identity(closed)}"
    raise Unnamed
