"""From a compiled step to an object file that needs neither Python nor numba.

Numba keeps the optimised LLVM module of a `cfunc`. Beside the function that C can call, which asks the interpreter for
its error messages, stands an inner one, `int inner(int32 *result, void **exception, <arguments of the step>)`. That one
is kept, under another name; what it does not call is removed, and so is the counting of references to arrays in memory
that nobody counts, once LLVM sees the whole.

LLVM ends the process where it cannot write code for a target: whoever calls this should be ready to lose it.
"""

import re
from typing import NamedTuple

import llvmlite.binding as llvm
from numba import cfunc

from twin.cosim.native import Step
from twin.errors import InputRefused

LINUX = "x86_64-unknown-linux-gnu"
MATHEMATICS = re.compile(
    r"(a?(sin|cos|tan)h?|atan2|sincos|exp|exp2|expm1|log|log2|log10|log1p|pow|sqrt|cbrt|hypot|floor|ceil|trunc|rint|"
    r"nearbyint|round|fabs|fmod|copysign|memcpy|memset|memmove)"
)
"""What a module may ask of its surroundings: libm, and the functions of memory that a compiler takes for granted."""


class Emitted(NamedTuple):
    """A step for one target.

    Attributes:
        symbol: of the function.
        text: LLVM's assembly of its module.
        content: of the object file.
    """

    symbol: str
    text: str
    content: bytes


def emitted(step: Step, symbol: str, triple: str = LINUX) -> Emitted:
    """The function `int symbol(int32 *, void **, void *self, double t, double h, const double *u, double *y)`.

    Raises:
        InputRefused: the step needs something that is not mathematics, memory of its own say.
    """
    # anew: what comes from the cache has no module
    compiled = cfunc(step.signature, error_model="numpy")(step.function)
    inner = compiled._wrapper_name.removeprefix("cfunc.")
    module = llvm.parse_assembly(str(compiled._library._final_module))
    for item in (*module.functions, *module.global_variables):
        if not item.is_declaration and item.name != inner:
            item.linkage = "internal"
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(triple).create_target_machine(
        cpu="x86-64" if triple.startswith("x86_64") else "", opt=3, reloc="pic"
    )
    passes = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
    passes.getModulePassManager().run(module, passes)
    module.get_function(inner).name = symbol
    text = str(module)
    foreign = [f.name for f in module.functions if f.is_declaration and not _is_mathematics(f.name)]
    if foreign:
        raise InputRefused(f"{symbol}: its compiled step needs {', '.join(sorted(foreign))}; it cannot leave Python")
    return Emitted(symbol, text, machine.emit_object(module))


def _is_mathematics(name: str) -> bool:
    if name.startswith("llvm."):
        return not name.startswith("llvm.x86.")
    return MATHEMATICS.fullmatch(name) is not None
