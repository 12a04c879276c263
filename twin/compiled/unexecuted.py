"""Numba without the machine code that it makes of every function while it compiles; of ours only modules are kept.

That code takes a tenth of the time, and nobody would call it: the machine code that is called is made of the module of
the outermost function, which has all others in it.
"""

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.registry import cpu_target

SELDOM = (50_000, 20, 20)
"""When garbage is looked for (`gc.set_threshold`). Numba makes objects by the million, hardly any of them in circles;
to look as often as usual takes a tenth of all."""


class _Library(JITCodeLibrary):
    """What a function is compiled to: optimised and linked, and then left at that."""

    def get_pointer_to_function(self, name: str) -> int:
        self._ensure_finalized()
        return 0

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._verify_declare_only_symbols()
        self._finalized = True


class _Codegen(JITCPUCodegen):
    _library_class = _Library

    def set_env(self, env_name: str, env: Any) -> None:
        """Nothing: it lies in machine code, for functions that Python calls."""


@contextmanager
def unexecuted() -> Iterator[None]:
    """Meanwhile what is compiled has no address; what calls it later takes it in, and may have one."""
    codegen = cpu_target.target_context.codegen()
    before, often = type(codegen), gc.get_threshold()
    codegen.__class__ = _Codegen
    gc.set_threshold(*SELDOM)
    try:
        yield
    finally:
        codegen.__class__ = before
        gc.set_threshold(*often)
