"""Calls into FMUs, announced before they are made.

A call may crash or never return; then only somebody outside this process can say which one it was, if told before.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager

Listener = Callable[[str, str, str], None]
_listeners: list[Listener] = []


def listen(listener: Listener) -> None:
    """From now on tell `listener` (file, instance, function) before each call; function "" when it has returned.

    Steps are not announced: they would cost more than they take (see `SimulationMemory.mark`).
    """
    _listeners.append(listener)


@contextmanager
def announced(file: str, instance: str, function: str) -> Iterator[None]:
    """Around a call of `function`."""
    for listener in _listeners:
        listener(file, instance, function)
    try:
        yield
    finally:
        for listener in _listeners:
            listener(file, instance, "")
