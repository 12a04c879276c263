"""Machine code of functions kept as object files, which are loaded without numba.

They lie in the folder of this source (`cache`), each with a seal at its end (`seal`), named after the function, what it
was closed over, its types, the processor and the compiler. An object file holds code that asks for nothing but
mathematics; a function whose code needs more, memory of its own say, stays numba's.
"""

import contextlib
import hashlib
import os
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numpy as np

from twin.compiled.cache import is_own, use_cache
from twin.compiled.function import Function
from twin.compiled.seal import sealed, unsealed

FOLDER = "objects"
_OWN = "twin."
_COMPILERS = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_OPT")
"""Variables that change what numba makes."""


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


def load(name: str) -> int | None:
    """Address of the function of an object file; None: there is none."""
    folder = _folder()
    content = unsealed(folder / f"{name}.o", folder) if folder else None
    return _loaded(name, content) if content else None


def keep(name: str, content: bytes) -> int:
    """Address of the function of a new object file; it is kept if that is possible."""
    folder = _folder()
    if folder:
        # a full disk, a folder that is gone: the code runs all the same
        with contextlib.suppress(OSError):
            folder.mkdir(exist_ok=True)
            aside = folder / f".{name}-{os.getpid()}"
            aside.write_bytes(sealed(content))
            aside.replace(folder / f"{name}.o")
    return _loaded(name, content)


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


def _loaded(name: str, content: bytes) -> int:
    engine = _engine()
    engine.add_object_file(llvm.ObjectFileRef.from_data(content))
    engine.finalize_object()
    return int(engine.get_function_address(name))


@cache
def _engine() -> Any:
    machine()
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine())


@cache
def _folder() -> Path | None:
    """Where object files are; None: the user has chosen a place for numba's files alone."""
    use_cache()
    folder = Path(os.environ["NUMBA_CACHE_DIR"])
    return folder / FOLDER if is_own(folder) else None


@cache
def _target() -> str:
    given = [os.environ.get(name, "") for name in _COMPILERS]
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
