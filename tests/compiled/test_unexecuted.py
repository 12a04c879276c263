"""Functions compiled to modules only: nothing of theirs is executed, and what calls them later is."""

import gc

import numba
from numba.core.registry import cpu_target

from twin.compiled.emission import module_of
from twin.compiled.function import Function

DOUBLE = numba.float64(numba.float64)


def twice(x: float) -> float:
    return 2.0 * x


def test_a_module_has_the_inner_functions_and_leaves_no_machine_code():
    inner = Function(twice)

    def outer(x: float) -> float:
        return inner(x) + 1.0

    before, often = type(cpu_target.target_context.codegen()), gc.get_threshold()
    module = module_of(DOUBLE, outer, "outer")
    assert module.inner in module.text
    (overload,) = inner.made.overloads.values()
    assert overload.library.get_pointer_to_function(overload.fndesc.llvm_func_name) == 0
    assert (type(cpu_target.target_context.codegen()), gc.get_threshold()) == (before, often)


def test_what_was_compiled_to_a_module_can_be_called_by_what_is_executed():
    inner = Function(twice)

    def outer(x: float) -> float:
        return inner(x) + 1.0

    module_of(DOUBLE, outer, "outer")
    assert Function(outer)(3.0) == 7.0
    assert inner(4.0) == 8.0
