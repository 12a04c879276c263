"""Ctrl-C in a sweep: noted wherever it falls, and raised only where a sweep can end.

An exception that a signal raises may fall between any two instructions: into a finaliser, where Python prints and
forgets it, or behind the instruction that takes a lock, which is never let go then.
"""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from twin.runs.guard.interrupt import INTERRUPTED

HEAR = 0.1
"""Longest time (s) that a sweep waits for anything before it asks whether Ctrl-C was pressed."""
PATIENCE = 3
"""So many times Ctrl-C in one sweep end the process, whatever it is doing."""


class _Presses:
    """Those of one sweep: one entry each. To append is one step; a counter would lose one that falls into the other."""

    def __init__(self) -> None:
        self.noted: list[int] = []
        self.raised = False

    def note(self, number: int, frame: FrameType | None) -> None:
        self.noted.append(number)
        if len(self.noted) >= PATIENCE:
            # what this process has started ends with it; rows are written as they come
            os.write(2, b"\ninterrupted; finished runs are kept\n")
            os._exit(INTERRUPTED)


_presses = _Presses()


@contextmanager
def remembered() -> Iterator[None]:
    """Meanwhile Ctrl-C is noted, and `raise_if_pressed` says so; the third one ends the process.

    Elsewhere than in the main thread there is no Ctrl-C, and nothing to remember. Nor is there where it was ignored or
    somebody else, a notebook's kernel say, has an answer of his own.

    Raises:
        KeyboardInterrupt: at the end, if it was pressed and not raised yet.
    """
    global _presses
    if not _ours() or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    _presses = _Presses()
    signal.signal(signal.SIGINT, _presses.note)
    try:
        yield
        raise_if_pressed()
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _presses = _Presses()


def raise_if_pressed() -> None:
    """Raise KeyboardInterrupt if Ctrl-C was pressed; once in a sweep, so that nothing disturbs its end."""
    if _ours() and _presses.noted and not _presses.raised:
        _presses.raised = True
        raise KeyboardInterrupt


def _ours() -> bool:
    return threading.current_thread() is threading.main_thread()
