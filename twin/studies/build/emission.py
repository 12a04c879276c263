"""Compiled steps as object files for any platform, see `twin.compiled.emission`.

Such a module knows no platform: its numbers have their sizes in their types, its pointers 64 bits, and what it takes
and gives are pointers and doubles, which every C takes in the same way. So LLVM writes it for any of them.

LLVM ends the process where it cannot write code for a platform: whoever calls this should be ready to lose it.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import llvmlite.binding as llvm

from twin.compiled.emission import Module, bare
from twin.errors import InputRefused
from twin.studies.build.layout import Layout
from twin.studies.build.platforms import Form, Platform


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


def emitted(step: Module, platform: Platform, form: Form) -> Emitted:
    """A form of `int symbol(int32 *, void **, void *self, double t, double h, const double *u, double *y)`.

    Raises:
        InputRefused: the step needs something that is not mathematics, memory of its own say.
    """
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    # not the code model of numba, which puts its code wherever there is room
    machine = llvm.Target.from_triple(platform.triple).create_target_machine(
        cpu=platform.cpu, features=form.features, opt=3, reloc="pic", codemodel="default"
    )
    module, foreign = bare(step, machine)
    if foreign:
        raise InputRefused(f"{step.symbol}: its compiled step needs {', '.join(foreign)}; it cannot leave Python")
    function = module.get_function(step.inner)
    # hidden: two parts in one process have steps of the same name
    function.name, function.visibility = step.symbol + form.suffix, "hidden"
    return Emitted(function.name, str(module), machine.emit_object(module))


def emitted_steps(
    layout: Layout, platforms: Sequence[Platform], say: Callable[[str], None]
) -> dict[Platform, list[Emitted]]:
    """All steps of a layout in all forms for each platform.

    Raises:
        InputRefused: a step cannot leave Python.
    """
    modules = []
    for row in layout.rows:
        say(f"compiling {row.component.name}")
        step: Any = row.step
        modules.append(step.module(row.symbol))
    return {
        platform: [emitted(module, platform, form) for module in modules for form in platform.forms]
        for platform in platforms
    }


def object_files(steps: Sequence[Emitted]) -> dict[str, bytes]:
    """Object files by their names."""
    return {f"{step.symbol}.o": step.content for step in steps}
