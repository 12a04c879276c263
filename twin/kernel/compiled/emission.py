"""From a compiled function to its LLVM module without numba's surroundings, and to machine code.

Numba keeps the optimised LLVM module of a `cfunc`. Beside the function that C can call, which asks the interpreter for
its error messages, stands an inner one, `int inner(result *, void **exception, <arguments>)`. That one is kept, and
what it calls; the counting of references to arrays in memory, which needs none, goes once LLVM sees the whole.
"""

import re
from collections.abc import Callable
from typing import Any, NamedTuple

import llvmlite.binding as llvm

from twin.kernel.compiled.numba_internals import inner_module

MATHEMATICS = re.compile(
    r"(a?(sin|cos|tan)h?|atan2|sincos|exp|exp2|expm1|log|log2|log10|log1p|pow|sqrt|cbrt|hypot|floor|ceil|trunc|rint|"
    r"nearbyint|round|fabs|fmod|copysign|memcpy|memset|memmove)"
)
"""What a module may ask of its surroundings: libm, and the functions of memory that a compiler takes for granted."""
RAISED = -1
"""What a function returns that should have raised an exception."""


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


def bare(module: Module, machine: Any) -> Any:
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
    return MATHEMATICS.fullmatch(name) is not None


def callable_by_c(module: Module, returned: str) -> Module:
    """`module` with a function in front of the inner one that takes its arguments and returns its result.

    Args:
        module: of a function.
        returned: LLVM's name of what it returns; it is RAISED in place of an exception.
    """
    inner = llvm.parse_assembly(module.text).get_function(module.inner)
    kinds = [str(argument.type) for argument in inner.arguments][2:]
    taken = ", ".join(f"{kind} %a{i}" for i, kind in enumerate(kinds))
    passed = ", ".join(filter(None, ("ptr %result", "ptr %exception", taken)))
    bad = RAISED if returned.startswith("i") else float(RAISED)
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
