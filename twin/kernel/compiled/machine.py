"""The form in which machine code is made for this processor, and object files loaded into this process."""

import hashlib
import os
from functools import cache
from importlib.metadata import version
from typing import Any, NamedTuple

import llvmlite.binding as llvm

from twin.kernel.compiled import store
from twin.kernel.errors import InputRefused

VARIABLE = "TWIN_PROCESSOR"
"""Names a form of X86_64 in place of the richest that this processor can run."""


class Form(NamedTuple):
    """Machine code for what not every processor of a kind has.

    Attributes:
        suffix: of the names of functions and of object files.
        features: that LLVM may use.
    """

    suffix: str
    features: str

    @property
    def name(self) -> str:
        """As `TWIN_PROCESSOR` has it."""
        return self.suffix.lstrip("_") or "any"


X86_64 = (Form("", ""), Form("_avx", "+avx"), Form("_avx512", "+avx512f,+avx512vl"))
"""All three give the same bits. Fig. 4's plant takes 1.14, 1.09 and 1.02 times as long as what is compiled for one
processor alone."""
OLDEST = "x86-64"
"""The oldest processor of this kind."""

_loaded: set[str] = set()
"""Functions whose object files are in this process."""


@cache
def compilers() -> tuple[str, ...]:
    """What machine code depends on besides its source and its form."""
    return version("numba"), version("llvmlite")


@cache
def chosen_form() -> Form:
    """The form that this process makes and loads.

    Raises:
        InputRefused: TWIN_PROCESSOR names none that this processor can run.
    """
    able = llvm.get_host_cpu_features()
    if llvm.get_process_triple().startswith("x86_64"):
        forms = [form for form in X86_64 if all(able.get(word[1:]) for word in form.features.split(",") if word)]
    else:
        # of others there is one, for this very processor
        known_by = f"{llvm.get_host_cpu_name()} {able.flatten()}".encode()
        forms = [Form(f"_{hashlib.blake2b(known_by, digest_size=8).hexdigest()}", able.flatten())]
    named = {form.name: form for form in forms}
    given = os.environ.get(VARIABLE) or forms[-1].name
    if given not in named:
        raise InputRefused(f"{VARIABLE}={given}: expected one of what this processor can run: {', '.join(named)}")
    return named[given]


@cache
def machine(form: Form) -> Any:
    """A processor of `form`, and code that may lie anywhere in memory."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=OLDEST if form in X86_64 else llvm.get_host_cpu_name(),
        features=form.features,
        opt=3,
        jit=True,
        reloc="default",
        codemodel="jitdefault",
    )


def file_of(name: str, form: Form) -> str:
    """The object file of the function `name` in a form."""
    return f"{name}{form.suffix}{store.OBJECT}"


def has(name: str) -> bool:
    """Whether there is an object file of the function `name`, which has an address from now on."""
    if name not in _loaded:
        content = store.stored_code(file_of(name, chosen_form()))
        if content:
            _load(name, content)
    return name in _loaded


def take(name: str, content: bytes) -> None:
    """Take a new object file; it is there for other processes too if that is possible."""
    store.keep(file_of(name, chosen_form()), content)
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
    here = machine(chosen_form())
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), here)
