"""An error on its way from one process to another."""

import importlib
import traceback
from typing import Any

from twin.kernel.errors import NotWritten, TwinError, system_sentence


def failure_report(problem: Exception) -> list[Any]:
    """What `error_of` makes an error of again: module and class, text, exit code."""
    if isinstance(problem, OSError):
        return failure_report(NotWritten(system_sentence(problem)))
    if not isinstance(problem, TwinError):
        return failure_report(TwinError(traceback.format_exc()))
    kind = type(problem)
    return [kind.__module__, kind.__qualname__, str(problem), problem.exit_code]


def error_of(report: list[Any]) -> TwinError:
    """The error of a `failure_report`: of the same class, with the same text and exit code.

    What else the error carried is not told: whoever needs that asks in the process itself.
    """
    module, name, text, exit_code = report
    kind = getattr(importlib.import_module(module), name, TwinError) if module.startswith("twin.") else TwinError
    # not called: what its __init__ wants is in the text already
    error: TwinError = kind.__new__(kind, text)
    error.exit_code = exit_code
    return error
