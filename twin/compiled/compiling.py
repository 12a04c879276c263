"""When this process compiles, for those who measure its time: no component is to be charged with that."""

import contextlib
from collections.abc import Callable, Iterator

Witness = Callable[[bool], None]
_witnesses: list[Witness] = []
_under_way: list[None] = []
"""One for each of what is being compiled, as a function may compile another one."""


def watch_compiling(witness: Witness) -> None:
    """From now on tell `witness` True when this process begins to compile, and False when it has done so."""
    _witnesses.append(witness)


@contextlib.contextmanager
def compiling() -> Iterator[None]:
    """Around what compiles, or waits for another process that compiles the same."""
    begin()
    try:
        yield
    finally:
        end()


def begin() -> None:
    """Something is being compiled, until `end`."""
    _under_way.append(None)
    if len(_under_way) == 1:
        for witness in _witnesses:
            witness(True)


def end() -> None:
    """One of what is being compiled is done."""
    _under_way.pop()
    if not _under_way:
        for witness in _witnesses:
            witness(False)
