"""Functions that are called in another process: named there, because what they import is loaded there."""

import importlib
from collections.abc import Callable
from typing import Any


def function_called(name: str) -> Callable[..., Any]:
    """The function "module:function"."""
    module, _, function = name.partition(":")
    found: Callable[..., Any] = getattr(importlib.import_module(module), function)
    return found
