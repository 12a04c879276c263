"""Machine code: LLVM modules without numba's runtime, the form for this processor, loading of object files.

Numba keeps the optimised LLVM module of a `cfunc`. It contains a function for C, which calls the interpreter to report
errors, and an inner function, `int inner(result *, void **exception, <arguments>)`. Only the inner function and its
callees are kept. Reference counting of arrays is not needed; LLVM removes it once it optimises the whole module.
"""

import hashlib
import os
import re
from functools import cache
from importlib.metadata import version
from typing import Any, NamedTuple

import llvmlite.binding as llvm

from twin.kernel.compiled import store
from twin.kernel.errors import InputRefused

MATH_SYMBOLS = re.compile(
    r"(a?(sin|cos|tan)h?|atan2|sincos|exp|exp2|expm1|log|log2|log10|log1p|pow|sqrt|cbrt|hypot|floor|ceil|trunc|rint|"
    r"nearbyint|round|fabs|fmod|copysign|memcpy|memset|memmove)"
)
"""Symbols that a module may import: libm, and the memory functions that a compiler assumes."""
EXCEPTION_STATUS = -1
"""Result of a compiled function in place of an exception."""
PROCESSOR_VARIABLE = "TWIN_PROCESSOR"
"""Environment variable that selects a form of X86_64 instead of the most capable one that this processor can run."""
BASELINE_CPU = "x86-64"
_loaded: set[str] = set()
"""Names of the functions whose object files are loaded in this process."""


class Module(NamedTuple):
    """LLVM module of a compiled function: C entry point `symbol` to add, numba's name of the `inner` one, and text."""

    symbol: str
    inner: str
    text: str


def strip_module(module: Module, machine: Any) -> Any:
    """Compile `module` with only its inner function exported; return it and imported symbols beyond mathematics."""
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
    """Add a C entry point that calls the inner function and returns its result, of the LLVM type `returned`.

    It returns EXCEPTION_STATUS in place of an exception.
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
        # numba's inner function returns status 0 if it ended with a value
        body += f"""  %ended = icmp eq i32 %status, 0
  %value = load {returned}, ptr %result
  %outcome = select i1 %ended, {returned} %value, {returned} {bad}
  ret {returned} %outcome
}}
"""
    return module._replace(inner=module.symbol, text=module.text + body)


class ProcessorForm(NamedTuple):
    """A variant of machine code: the instruction sets it may use, and the suffix of its functions and object files."""

    suffix: str
    features: str

    @property
    def name(self) -> str:
        """Name of the processor form, the value of TWIN_PROCESSOR that selects it."""
        return self.suffix.lstrip("_") or "any"


X86_64 = (ProcessorForm("", ""), ProcessorForm("_avx", "+avx"), ProcessorForm("_avx512", "+avx512f,+avx512vl"))
"""Forms for x86-64; all three give the same bits. The plant of Fig. 4 takes 1.14, 1.09 and 1.02 times as long as code
compiled for the exact processor."""


@cache
def compiler_versions() -> tuple[str, ...]:
    """Return the versions of numba and llvmlite, as machine code depends on them."""
    return version("numba"), version("llvmlite")


@cache
def chosen_form() -> ProcessorForm:
    """Return the processor form (set of allowed instructions) that this process compiles for and loads."""
    able = llvm.get_host_cpu_features()
    if llvm.get_process_triple().startswith("x86_64"):
        forms = [form for form in X86_64 if all(able.get(word[1:]) for word in form.features.split(",") if word)]
    else:
        # other architectures have one form, for this exact processor
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
    """Create an LLVM target machine, which generates relocatable code for a processor form."""
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
    return f"{name}{form.suffix}{store.OBJECT_SUFFIX}"


def load_object(name: str) -> bool:
    """Load a compiled function from its object file if the store has one; return whether the function is loaded."""
    if name not in _loaded and (content := store.stored_code(object_name(name, chosen_form()))):
        _load(name, content)
    return name in _loaded


def store_object(name: str, content: bytes) -> None:
    """Store a new object file for other processes, if the folder is writable, and load it into this process."""
    store.store_file(object_name(name, chosen_form()), content)
    _load(name, content)


def function_address(symbol: str) -> int:
    """Return the address of a compiled function in a loaded object file."""
    return int(_engine().get_function_address(symbol))


def _load(name: str, content: bytes) -> None:
    _engine().add_object_file(llvm.ObjectFileRef.from_data(content))
    _engine().finalize_object()
    _loaded.add(name)


@cache
def _engine() -> Any:
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), target_machine(chosen_form()))
