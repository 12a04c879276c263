"""Machine code: LLVM modules without numba's surroundings, the form for this processor, object files loaded.

Numba keeps the optimised LLVM module of a `cfunc`. Beside the function that C can call, which asks the interpreter for
its error messages, stands an inner one, `int inner(result *, void **exception, <arguments>)`. That one is kept, and
what it calls; the counting of references to arrays in memory, which needs none, goes once LLVM sees the whole.
"""

import hashlib
import os
import re
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from typing import Any, NamedTuple

import llvmlite.binding as llvm

from twin.kernel.compiled import store
from twin.kernel.compiled.numba_internals import inner_module
from twin.kernel.errors import InputRefused

MATH_SYMBOLS = re.compile(
    r"(a?(sin|cos|tan)h?|atan2|sincos|exp|exp2|expm1|log|log2|log10|log1p|pow|sqrt|cbrt|hypot|floor|ceil|trunc|rint|"
    r"nearbyint|round|fabs|fmod|copysign|memcpy|memset|memmove)"
)
"""What a module may ask of its surroundings: libm, and the functions of memory that a compiler takes for granted."""
EXCEPTION_STATUS = -1
"""What a function returns that should have raised an exception."""
PROCESSOR_VARIABLE = "TWIN_PROCESSOR"
"""Names a form of X86_64 in place of the richest that this processor can run."""
BASELINE_CPU = "x86-64"
"""The oldest processor of this kind."""


class Module(NamedTuple):
    """A compiled function as numba leaves it.

    Attributes:
        symbol: as it will be called.
        inner: as numba calls it.
        text: LLVM's assembly.
    """

    symbol: str
    inner: str
    text: str


def module_of(signature: Any, function: Callable, symbol: str) -> Module:
    """The module of `function`, compiled for a `signature` of numba's, that shall be called `symbol`."""
    return Module(symbol, *inner_module(signature, function))


def strip_module(module: Module, machine: Any) -> Any:
    """The LLVM module of `module` with its inner function alone visible, for a target machine.

    Returns:
        (module, names of what it needs and is not mathematics).
    """
    made = llvm.parse_assembly(module.text)
    made.triple, made.data_layout = machine.triple, str(machine.target_data)
    for item in (*made.functions, *made.global_variables):
        if not item.is_declaration and item.name != module.inner:
            item.linkage = "internal"
    passes = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
    passes.getModulePassManager().run(made, passes)
    return made, sorted(f.name for f in made.functions if f.is_declaration and not _is_mathematics(f.name))


def _is_mathematics(name: str) -> bool:
    if name.startswith("llvm."):
        return not name.startswith("llvm.x86.")
    return MATH_SYMBOLS.fullmatch(name) is not None


def with_c_entry(module: Module, returned: str) -> Module:
    """`module` with a function in front of the inner one that takes its arguments and returns its result.

    Args:
        module: of a function.
        returned: LLVM's name of what it returns; it is RAISED in place of an exception.
    """
    inner = llvm.parse_assembly(module.text).get_function(module.inner)
    kinds = [str(argument.type) for argument in inner.arguments][2:]
    taken = ", ".join(f"{kind} %a{i}" for i, kind in enumerate(kinds))
    passed = ", ".join(filter(None, ("ptr %result", "ptr %exception", taken)))
    bad = EXCEPTION_STATUS if returned.startswith("i") else float(EXCEPTION_STATUS)
    body = f"""
define {returned} @"{module.symbol}"({taken}) {{
  %result = alloca {"i64" if returned == "void" else returned}
  %exception = alloca ptr
  %status = call i32 @"{module.inner}"({passed})
"""
    if returned == "void":
        body += "  ret void\n}\n"
    else:
        # numba's code of a function that ended with a value
        body += f"""  %ended = icmp eq i32 %status, 0
  %value = load {returned}, ptr %result
  %outcome = select i1 %ended, {returned} %value, {returned} {bad}
  ret {returned} %outcome
}}
"""
    return module._replace(inner=module.symbol, text=module.text + body)


class ProcessorForm(NamedTuple):
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


X86_64 = (ProcessorForm("", ""), ProcessorForm("_avx", "+avx"), ProcessorForm("_avx512", "+avx512f,+avx512vl"))
"""All three give the same bits. Fig. 4's plant takes 1.14, 1.09 and 1.02 times as long as what is compiled for one
processor alone."""

_loaded: set[str] = set()
"""Functions whose object files are in this process."""


@cache
def compiler_versions() -> tuple[str, ...]:
    """What machine code depends on besides its source and its form."""
    return version("numba"), version("llvmlite")


@cache
def chosen_form() -> ProcessorForm:
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
        forms = [ProcessorForm(f"_{hashlib.blake2b(known_by, digest_size=8).hexdigest()}", able.flatten())]
    named = {form.name: form for form in forms}
    given = os.environ.get(PROCESSOR_VARIABLE) or forms[-1].name
    if given not in named:
        raise InputRefused(
            f"{PROCESSOR_VARIABLE}={given}: expected one of what this processor can run: {', '.join(named)}"
        )
    return named[given]


@cache
def target_machine(form: ProcessorForm) -> Any:
    """A processor of `form`, and code that may lie anywhere in memory."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    return llvm.Target.from_default_triple().create_target_machine(
        cpu=BASELINE_CPU if form in X86_64 else llvm.get_host_cpu_name(),
        features=form.features,
        opt=3,
        jit=True,
        reloc="default",
        codemodel="jitdefault",
    )


def object_name(name: str, form: ProcessorForm) -> str:
    """The object file of the function `name` in a form."""
    return f"{name}{form.suffix}{store.OBJECT_SUFFIX}"


def load_object(name: str) -> bool:
    """Whether there is an object file of the function `name`, which has an address from now on."""
    if name not in _loaded:
        content = store.stored_code(object_name(name, chosen_form()))
        if content:
            _load(name, content)
    return name in _loaded


def store_object(name: str, content: bytes) -> None:
    """Take a new object file; it is there for other processes too if that is possible."""
    store.store_file(object_name(name, chosen_form()), content)
    _load(name, content)


def function_address(symbol: str) -> int:
    """Of a function of an object file that is there."""
    return int(_engine().get_function_address(symbol))


def _load(name: str, content: bytes) -> None:
    _engine().add_object_file(llvm.ObjectFileRef.from_data(content))
    _engine().finalize_object()
    _loaded.add(name)


@cache
def _engine() -> Any:
    here = target_machine(chosen_form())
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), here)
