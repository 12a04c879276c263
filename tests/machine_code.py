"""Tests call compiled functions as machine code; where the twin's own Python calls one, it calls its source."""

import functools
import hashlib
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from twin.kernel.cache_folder import evict
from twin.kernel.compiled.function import Function
from twin.robot.paths import PACKAGE_FOLDER, package_sources

KEPT = 3
"""Sources whose machine code is kept."""


_OWN = Function.__call__


def call_compiled() -> None:
    """From now on, in this process."""
    Function.__call__ = _called  # type: ignore[method-assign, assignment]


def _called(function: Function, *arguments: Any) -> Any:
    by_test = sys._getframe(1).f_globals.get("__name__", "").startswith("tests.")
    return _compiled(function)(*arguments) if by_test else _OWN(function, *arguments)


@functools.cache
def _compiled(function: Function) -> Callable:
    import numba

    numba.config.CACHE_DIR = str(_folder())
    made: Callable = numba.njit(**function.options)(function.__wrapped__)
    return made


@functools.cache
def _folder() -> Path:
    """Of what numba keeps: it looks at a function's own file only, so each source has a folder of its own."""
    digest = hashlib.sha256()
    for name, source in package_sources(str(PACKAGE_FOLDER)).items():
        digest.update(name.encode() + b"\0" + source + b"\0")
    folder = PACKAGE_FOLDER / "__pycache__" / "tests" / digest.hexdigest()[:16]
    folder.mkdir(parents=True, exist_ok=True)
    evict(folder.parent, KEPT)
    return folder
