"""Every Python that has this folder on its PYTHONPATH notes which lines of twin it runs (`tests.mutants.executed`).

A line is written at once: processes are killed, forked, and close files that they do not know.
"""

import os
import sys
import threading
from types import CodeType, FrameType
from typing import Any

NOTES = os.environ.get("MUTANTS_NOTES", "")
"""File that lines are added to: `path:line`, and `path:line:import` where a module is being imported."""
SOURCE = os.environ.get("MUTANTS_SOURCE", "")
"""Folder of the files that count."""
MOST = 20_000
"""Lines of one function that are looked at; after that all of it counts as run, and it costs no more time."""

_known: dict[int, "_Function"] = {}


class _Function:
    """A function or module of twin: the lines that were not run yet."""

    def __init__(self, code: CodeType):
        # its number is nobody else's as long as it is here
        self.code, self.looked = code, 0
        self.left = {line for _, _, line in code.co_lines() if line}

    def __call__(self, frame: FrameType, event: str, argument: Any) -> "_Function":
        self.looked += 1
        if frame.f_lineno in self.left:
            self.left.remove(frame.f_lineno)
            self._note([frame.f_lineno], ":import" if _is_importing(frame) else "")
        if self.looked == MOST:
            self._note(self.left, "")
            self.left = set()
        frame.f_trace_lines = bool(self.left)
        return self

    def _note(self, lines: Any, end: str) -> None:
        with open(NOTES, "a") as file:
            file.write("".join(f"{self.code.co_filename}:{line}{end}\n" for line in lines))


def _is_importing(frame: FrameType | None) -> bool:
    while frame:
        code = frame.f_code
        if code.co_name == "<module>" and code.co_filename.startswith(SOURCE):
            return frame.f_globals.get("__name__") != "__main__"
        frame = frame.f_back
    return False


def _called(frame: FrameType, event: str, argument: Any) -> Any:
    code = frame.f_code
    if not code.co_filename.startswith(SOURCE):
        return None
    function = _known.get(id(code))
    if function is None:
        function = _known[id(code)] = _Function(code)
    return function(frame, event, argument) if function.left else None


if NOTES and SOURCE:
    threading.settrace(_called)
    sys.settrace(_called)
