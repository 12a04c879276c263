"""How the work of a reader grows with its input, whatever else the machine does."""

import sys
import time
from collections.abc import Callable
from types import FrameType
from typing import Any

FACTOR = 4
TRIES = 5


def lines(function: Callable[[], Any]) -> int:
    """Number of lines of Python that a call runs, which no other load of the machine changes."""
    count = 0

    def trace(frame: FrameType, event: str, argument: Any) -> Any:
        nonlocal count
        count += 1
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        function()
    finally:
        sys.settrace(before)
    return count


def cpu_seconds(function: Callable[[], Any]) -> float:
    """Processor time (s) of a call, also within compiled libraries; other processes do not count."""
    began = time.process_time()
    function()
    return time.process_time() - began


def assert_linear_in_lines(few: Callable[[], Any], many: Callable[[], Any], factor: float) -> None:
    """Check that `many`, with `factor` times the input, runs no more than `factor` times the lines of `few`."""
    # what is read once in a process
    few()
    assert lines(many) < 1.1 * factor * lines(few)


def assert_linear(prepared: Callable[[int], Callable[[], Any]], size: int) -> None:
    """Check that the work of a call grows as the size of its input: lines of Python exactly, processor time roughly.

    Args:
        prepared: returns the call for a size.
        size: large enough for some 10 ms; lines are counted for an eighth of it, because counting is slow.
    """
    assert_linear_in_lines(prepared(size // 8), prepared(size // 2), FACTOR)
    few, many = prepared(size), prepared(FACTOR * size)
    # half of the way to the square; whatever disturbs one try does not disturb all
    bound, tried = FACTOR**1.5, []
    for _ in range(TRIES):
        tried.append(cpu_seconds(many) / cpu_seconds(few))
        if tried[-1] < bound:
            return
    raise AssertionError(f"{FACTOR} times the input takes {min(tried):.1f} times the processor time")
