"""Ctrl-C that is not lost: one that reaches this process in a finalizer of somebody's object is printed and ignored."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType


@contextmanager
def remembered() -> Iterator[Callable[[], None]]:
    """Meanwhile Ctrl-C does what it did before; the function given raises KeyboardInterrupt if there was one.

    Elsewhere than in the main thread there is no Ctrl-C, and nothing to remember. Nor is there where it was ignored or
    somebody else, a notebook's kernel say, has an answer of his own.
    """
    pressed = threading.Event()

    def note(number: int, frame: FrameType | None) -> None:
        pressed.set()
        signal.default_int_handler(number, frame)

    def raise_if_pressed() -> None:
        if pressed.is_set():
            raise KeyboardInterrupt

    ours = threading.current_thread() is threading.main_thread()
    if not ours or signal.getsignal(signal.SIGINT) is not signal.default_int_handler:
        yield raise_if_pressed
        return
    signal.signal(signal.SIGINT, note)
    try:
        yield raise_if_pressed
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
