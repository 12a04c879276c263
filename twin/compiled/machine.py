"""The processor of this machine, and object files loaded into this process."""

import os
from functools import cache
from importlib.metadata import version
from typing import Any

import llvmlite
import llvmlite.binding as llvm

from twin.compiled import store

_COMPILERS = ("NUMBA_CPU_NAME", "NUMBA_CPU_FEATURES", "NUMBA_OPT")
"""Variables that change what numba makes."""

_loaded: set[str] = set()
"""Names of object files of this process."""


@cache
def target() -> str:
    """What machine code depends on besides its source."""
    given = [os.environ.get(name, "") for name in _COMPILERS]
    features = llvm.get_host_cpu_features().flatten()
    return repr((version("numba"), llvmlite.__version__, llvm.get_host_cpu_name(), features, given))


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


def has(name: str) -> bool:
    """Whether there is an object file of that name; its function has an address from now on."""
    if name not in _loaded:
        content = store.kept(name + store.OBJECT)
        if content:
            _load(name, content)
    return name in _loaded


def take(name: str, content: bytes) -> None:
    """Take a new object file; it is there for other processes too if that is possible."""
    store.keep(name + store.OBJECT, content)
    _load(name, content)


def address(symbol: str) -> int:
    """Of a function of an object file that is there."""
    return int(_engine().get_function_address(symbol))


def _load(name: str, content: bytes) -> None:
    _engine().add_object_file(llvm.ObjectFileRef.from_data(content))
    _engine().finalize_object()
    _loaded.add(name)


@cache
def _engine() -> Any:
    machine()
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), machine())
