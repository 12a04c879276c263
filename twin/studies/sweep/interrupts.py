"""Deferred Ctrl-C during a sweep: the press is recorded and raised where no row is lost."""

import os
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from twin.kernel.process.job import INTERRUPT_EXIT_CODE

MAX_PRESSES = 3
"""Number of Ctrl-C presses in one sweep that ends the process immediately."""


class _Presses:
    """The Ctrl-C presses during one sweep, a list, since append is atomic while a counter could lose a press."""

    def __init__(self) -> None:
        self.noted: list[int] = []
        self.raised = False

    def note(self, number: int, frame: FrameType | None) -> None:
        self.noted.append(number)
        if len(self.noted) >= MAX_PRESSES:
            # Child processes end with this one; rows are already on disk.
            os.write(2, b"\ninterrupted; finished runs are kept\n")
            os._exit(INTERRUPT_EXIT_CODE)


_presses = _Presses()


@contextmanager
def defer_interrupts() -> Iterator[None]:
    """Defer Ctrl-C within the block until `raise_interrupt` or its end; the third press ends the process.

    Nothing changes outside the main thread, or where SIGINT is ignored or has a handler, such as a notebook's.
    """
    global _presses
    if not _in_main_thread() or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield
        return
    _presses = _Presses()
    signal.signal(signal.SIGINT, _presses.note)
    try:
        yield
        raise_interrupt()
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        _presses = _Presses()


def raise_interrupt() -> None:
    """Raise KeyboardInterrupt once if Ctrl-C was pressed during the sweep, not during the cleanup that follows."""
    if _in_main_thread() and _presses.noted and not _presses.raised:
        _presses.raised = True
        raise KeyboardInterrupt


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()
