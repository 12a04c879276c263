"""All that is used of numba's insides: private names, and modules of `numba.core`, which a new version may change.

`pyproject.toml` allows no version for which the tests of this file were not run. Numba is imported when one of them is
used.
"""

import gc
from collections.abc import Callable
from typing import Any

GC_THRESHOLDS = (50_000, 20, 20)
"""When garbage is looked for (`gc.set_threshold`). Numba makes objects by the million, hardly any of them in circles;
to look as often as usual takes a tenth of all."""


class NumbaObject:
    """What numba meets in the source of a function, and asks for its type."""

    @property
    def numba_object(self) -> Any:
        """What numba works with in its place."""
        raise NotImplementedError

    @property
    def _numba_type_(self) -> Any:
        return _target().typing_context.resolve_value_type(self.numba_object)


def refresh() -> None:
    """Let numba see what was registered while it is in the middle of a compilation."""
    _target().typing_context.refresh()
    _target().target_context.refresh()


def inner_module(signature: Any, function: Callable) -> tuple[str, str]:
    """(name of the inner function, LLVM's assembly of the module) of `function`, compiled as a `cfunc`."""
    from numba import cfunc

    often = gc.get_threshold()
    gc.set_threshold(*GC_THRESHOLDS)
    try:
        # anew: what comes from numba's cache has no module
        compiled = cfunc(signature, error_model="numpy")(function)
    finally:
        gc.set_threshold(*often)
    return compiled._wrapper_name.removeprefix("cfunc."), str(compiled._library._final_module)


def declare_function(module: Any, kind: Any, name: str) -> Any:
    """The function `name` of LLVM's type `kind`, declared in `module`."""
    from numba.core import cgutils

    return cgutils.get_or_insert_function(module, kind, name)


def infer(function: Any, *signatures: tuple[Any, ...]) -> None:
    """Make known what `function` returns for arguments: (returned, arguments ...) each."""
    from numba.core.typing.templates import ConcreteTemplate, infer_global, signature

    cases = [signature(*types) for types in signatures]
    infer_global(function)(type("Cases", (ConcreteTemplate,), {"key": function, "cases": cases}))


def _target() -> Any:
    from numba.core.registry import cpu_target

    return cpu_target
