"""Ticks that wait for the clock on the wall, in compiled code.

Deadlines are absolute: tick k is due k times its duration after the beginning, whatever came before, so nothing adds
up, and what was held up catches up. The wait is clock_nanosleep(2) with TIMER_ABSTIME on the monotonic clock: being
interrupted between a look at the clock and the wait moves nothing.
"""

import ctypes
import math
import time
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from twin.kernel.compiled.function import c, carray, intrinsic, ir, njit, pointer_to, types
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.histogram import Histogram, count_in
from twin.kernel.cosim.port import memory_of, record

MIN_WAIT = 1e-3
"""Wall time (s) between two deadlines, at least: what a sleep oversleeps by is to be little of it."""
TIMER_ABSTIME, NS_PER_SECOND = 1, 10**9
DEADLINE_RECORD = record(
    advance="i8",  # address of what makes ticks
    loop="i8",  # and of its memory
    clock="i8",  # address of clock_gettime
    sleep="i8",  # of clock_nanosleep
    clock_id="i8",
    time="i8",  # of a struct timespec
    start="i8",  # the first tick, which is never late; -1: still to come
    begun="i8",  # ns of tick 0
    tick="f8",  # ns
    every="i8",  # ticks from one deadline to the next
    last="i8",  # tick of the last deadline
    count="i8",  # deadlines
    missed="i8",
    worst="f8",  # s
    newest="f8",  # lateness at the last deadline, s
    largest="f8",
    sum="f8",  # of all
    squares="f8",
    waited="f8",  # s
    bins="i8",  # address of their histogram
)
"""What the waiting is made of, and what it came to."""

_deadlines_at, _times_at = pointer_to(DEADLINE_RECORD), pointer_to(np.int64)


@cache
def clock_functions() -> tuple[Any, ...]:
    """What has the addresses of clock_gettime and clock_nanosleep, and the number of the monotonic clock.

    A system that has them not gets them made of Python's clock.
    """
    library = ctypes.CDLL(None)
    if hasattr(library, "clock_nanosleep"):
        return library.clock_gettime, library.clock_nanosleep, time.CLOCK_MONOTONIC
    return (*callbacks(time.monotonic, time.sleep), 0)


def callbacks(monotonic: Any, sleep: Any) -> tuple[Any, Any]:
    """The two functions, for compiled code, made of two of Python like those of `time`."""
    timespec = ctypes.POINTER(ctypes.c_int64)

    @ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int, timespec)
    def clock(number: int, at: Any) -> int:
        at[0], at[1] = divmod(round(monotonic() * NS_PER_SECOND), NS_PER_SECOND)
        return 0

    @ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int, ctypes.c_int, timespec, ctypes.c_void_p)
    def nap(number: int, flags: int, until: Any, rest: int) -> int:
        sleep(max(0.0, until[0] + until[1] / NS_PER_SECOND - monotonic()))
        return 0

    return clock, nap


def _pointer_call(arguments: str) -> Any:
    """A compiled call of `int f(...)` at an address; i: an int, p: an address."""

    def call(typingctx, function, first, second, third, fourth):
        kinds = [c.i32 if one == "i" else c.pointer for one in arguments]

        def codegen(context, builder, signature, values):
            kind = ir.FunctionType(c.i32, kinds)
            given = [
                builder.trunc(value, c.i32) if one == "i" else builder.inttoptr(value, c.pointer)
                for one, value in zip(arguments, values[1:], strict=False)
            ]
            return builder.call(builder.inttoptr(values[0], kind.as_pointer()), given)

        return types.int32(*[types.int64] * 5), codegen

    return intrinsic(call)


_clock_call, _sleep_call = _pointer_call("ip"), _pointer_call("iipp")


@intrinsic
def _advance_call(typingctx, function, loop, first, count, row):
    """`int64 advance(loop, first, count, row)` at an address."""

    def codegen(context, builder, signature, values):
        kind = ir.FunctionType(c.i64, [c.i64] * 4)
        return builder.call(builder.inttoptr(values[0], kind.as_pointer()), values[1:])

    return types.int64(*[types.int64] * 5), codegen


@njit(cache=True)
def _clock_ns(m):
    """ns."""
    _clock_call(m.clock, m.clock_id, m.time, 0, 0)
    at = carray(_times_at(m.time), 2)
    return at[0] * NS_PER_SECOND + at[1]


@njit(cache=True)
def _wait_until_due(m, k):
    """Wait until tick `k` is due; False: a signal came first, which Python is to see."""
    due = m.begun + np.int64(np.rint(k * m.tick))
    now = _clock_ns(m)
    if now < due:
        at = carray(_times_at(m.time), 2)
        at[0], at[1] = due // NS_PER_SECOND, due % NS_PER_SECOND
        interrupted = _sleep_call(m.sleep, m.clock_id, TIMER_ABSTIME, m.time, 0) != 0
        woken = _clock_ns(m)
        m.waited += 1e-9 * (woken - now)
        if interrupted:
            return False
        now = woken
    else:
        m.missed += now > due
        m.worst = max(m.worst, 1e-9 * (now - due))
    m.newest = 1e-9 * (now - due)
    m.count += 1
    m.last, m.largest = k, max(m.largest, m.newest)
    m.sum += m.newest
    m.squares += m.newest * m.newest
    count_in(m.bins, m.newest)
    return True


@entry("int", "int", "int", "int", "int")
def advance(deadlines, first, count, row):
    """As `master.advance`, each tick when it is due; fewer rows if a signal came.

    Args:
        deadlines: address of a record of `DEADLINE_RECORD`.
    """
    m = carray(_deadlines_at(deadlines), 1)[0]
    if m.start < 0 and count > 0:
        m.start, m.begun = first, _clock_ns(m) - np.int64(np.rint(first * m.tick))
    done = 0
    while done < count:
        k = first + done
        if k % m.every == 0 and k > m.start and not _wait_until_due(m, k):
            return done
        most = min(m.every - k % m.every, count - done)
        made = _advance_call(m.advance, m.loop, k, most, row + done)
        if made < 0:
            return made - done
        done += made
        if made < most:
            return done
    return done


class Deadlines:
    """Of a simulation whose ticks pass with the clock on the wall.

    Args:
        tick: wall time of a tick (s), > 0.
        functions: see `clock_functions`.

    Attributes:
        memory: (1,) of `DEADLINE_RECORD`.
        address: of it.
        lateness: time from a deadline to going on.
    """

    def __init__(self, tick: float, functions: tuple[Any, ...]):
        *self._functions, number = functions
        clock, sleep = (ctypes.cast(one, ctypes.c_void_p).value for one in self._functions)
        self._time = np.zeros(2, dtype=np.int64)
        self.lateness = Histogram()
        self.memory = memory_of(
            DEADLINE_RECORD, clock=clock, sleep=sleep, clock_id=number, time=self._time.ctypes.data, start=-1,
            tick=tick * NS_PER_SECOND, every=max(1, math.ceil(MIN_WAIT / tick - 1e-9)), bins=self.lateness.bins.ctypes.data,
        )  # fmt: skip
        self.address = self.memory.ctypes.data

    def paced_advance(self, ticks: Any, loop: int) -> Callable[[int, int, int, int], int]:
        """`advance`, which calls `ticks`, a function of C like it, with the memory at `loop`."""
        self.memory["advance"], self.memory["loop"] = ctypes.cast(ticks, ctypes.c_void_p).value, loop
        found: Callable[[int, int, int, int], int] = advance.native.c_function
        return found

    @property
    def counts(self) -> dict[str, float]:
        """What the waiting came to so far, by the names of `DEADLINE_RECORD`."""
        found = dict(zip(DEADLINE_RECORD.names or (), self.memory[0].item(), strict=True))
        self.lateness.largest = found["largest"]
        return found
