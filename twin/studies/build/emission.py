"""From a compiled step to object files that need neither Python nor numba.

Numba keeps the optimised LLVM module of a `cfunc`. Beside the function that C can call, which asks the interpreter for
its error messages, stands an inner one, `int inner(int32 *result, void **exception, <arguments of the step>)`. That one
is kept, under another name; what it does not call is removed, and so is the counting of references to arrays in memory
that nobody counts, once LLVM sees the whole.

Such a module knows no platform: its numbers have their sizes in their types, its pointers 64 bits, and what it takes
and gives are pointers and doubles, which every C takes in the same way. So LLVM writes it for any of them.

LLVM ends the process where it cannot write code for a platform: whoever calls this should be ready to lose it.
"""

import re
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import llvmlite.binding as llvm
from numba import cfunc

from twin.cosim.native import Step
from twin.errors import InputRefused
from twin.studies.build.layout import Layout
from twin.studies.build.platforms import Platform

MATHEMATICS = re.compile(
    r"(a?(sin|cos|tan)h?|atan2|sincos|exp|exp2|expm1|log|log2|log10|log1p|pow|sqrt|cbrt|hypot|floor|ceil|trunc|rint|"
    r"nearbyint|round|fabs|fmod|copysign|memcpy|memset|memmove)"
)
"""What a module may ask of its surroundings: libm, and the functions of memory that a compiler takes for granted."""


class Module(NamedTuple):
    """A step as numba leaves it.

    Attributes:
        symbol: its function's, as it will be called.
        inner: as numba calls it.
        text: LLVM's assembly.
    """

    symbol: str
    inner: str
    text: str


class Emitted(NamedTuple):
    """A step for one platform.

    Attributes:
        symbol: of the function.
        text: LLVM's assembly of what was written.
        content: of the object file.
    """

    symbol: str
    text: str
    content: bytes


def module_of(step: Step, symbol: str) -> Module:
    """The module of `step`, whose function shall be called `symbol`."""
    # anew: what comes from the cache has no module
    compiled = cfunc(step.signature, error_model="numpy")(step.function)
    return Module(symbol, compiled._wrapper_name.removeprefix("cfunc."), str(compiled._library._final_module))


def emitted(step: Module, platform: Platform) -> Emitted:
    """The function `int symbol(int32 *, void **, void *self, double t, double h, const double *u, double *y)`.

    Raises:
        InputRefused: the step needs something that is not mathematics, memory of its own say.
    """
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    # not the code model of numba, which puts its code wherever there is room
    machine = llvm.Target.from_triple(platform.triple).create_target_machine(
        cpu=platform.cpu, opt=3, reloc="pic", codemodel="default"
    )
    module = llvm.parse_assembly(step.text)
    module.triple, module.data_layout = platform.triple, str(machine.target_data)
    for item in (*module.functions, *module.global_variables):
        if not item.is_declaration and item.name != step.inner:
            item.linkage = "internal"
    passes = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
    passes.getModulePassManager().run(module, passes)
    function = module.get_function(step.inner)
    # hidden: two parts in one process have steps of the same name
    function.name, function.visibility = step.symbol, "hidden"
    text = str(module)
    foreign = [f.name for f in module.functions if f.is_declaration and not _is_mathematics(f.name)]
    if foreign:
        raise InputRefused(
            f"{step.symbol}: its compiled step needs {', '.join(sorted(foreign))}; it cannot leave Python"
        )
    return Emitted(step.symbol, text, machine.emit_object(module))


def _is_mathematics(name: str) -> bool:
    if name.startswith("llvm."):
        return not name.startswith("llvm.x86.")
    return MATHEMATICS.fullmatch(name) is not None


def emitted_steps(
    layout: Layout, platforms: Sequence[Platform], say: Callable[[str], None]
) -> dict[Platform, list[Emitted]]:
    """All steps of a layout for each platform.

    Raises:
        InputRefused: a step cannot leave Python.
    """
    modules = []
    for row in layout.rows:
        say(f"compiling {row.component.name}")
        step: Any = row.step
        modules.append(module_of(step, row.symbol))
    return {platform: [emitted(module, platform) for module in modules] for platform in platforms}


def object_files(steps: Sequence[Emitted]) -> dict[str, bytes]:
    """Object files by their names."""
    return {f"{step.symbol}.o": step.content for step in steps}
