"""Access to numba's internals: private names, and modules of `numba.core` that a new version may change.

`pyproject.toml` allows only the numba versions that the tests of this file ran with. Numba is imported on first use.
"""

import gc
from collections.abc import Callable
from typing import Any

GC_THRESHOLDS = (50_000, 20, 20)
"""Thresholds of garbage collection while numba compiles (`gc.set_threshold`). Numba allocates millions of objects,
hardly any of them in reference cycles; the default thresholds cost a tenth of the compile time."""


class NumbaObject:
    """Base of objects in the source of a compiled function that numba objects replace at compilation."""

    @property
    def numba_object(self) -> Any:
        """The numba object that replaces this object during compilation."""
        raise NotImplementedError

    @property
    def _numba_type_(self) -> Any:
        return _target().typing_context.resolve_value_type(self.numba_object)


def refresh() -> None:
    """Refresh numba's registries, so that functions and types registered during a compilation become visible."""
    _target().typing_context.refresh()
    _target().target_context.refresh()


def inner_module(signature: Any, function: Callable) -> tuple[str, str]:
    """Compile `function` as a numba `cfunc`; return (name of the inner function, LLVM assembly of the module)."""
    from numba import cfunc

    previous = gc.get_threshold()
    gc.set_threshold(*GC_THRESHOLDS)
    try:
        # compiled without cache: a function loaded from numba's cache has no LLVM module
        compiled = cfunc(signature, error_model="numpy")(function)
    finally:
        gc.set_threshold(*previous)
    return compiled._wrapper_name.removeprefix("cfunc."), str(compiled._library._final_module)


def declare_function(module: Any, kind: Any, name: str) -> Any:
    """Declare an external function of LLVM type `kind` in an LLVM module, or return the existing declaration."""
    from numba.core import cgutils

    return cgutils.get_or_insert_function(module, kind, name)


def infer(function: Any, *signatures: tuple[Any, ...]) -> None:
    """Register the `signatures` of `function`, (result type, argument types ...), with numba's type inference."""
    from numba.core.typing.templates import ConcreteTemplate, infer_global, signature

    cases = [signature(*types) for types in signatures]
    infer_global(function)(type("Cases", (ConcreteTemplate,), {"key": function, "cases": cases}))


def _target() -> Any:
    from numba.core.registry import cpu_target

    return cpu_target
