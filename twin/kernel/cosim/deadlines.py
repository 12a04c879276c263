"""Real-time pacing of ticks in compiled code.

Deadlines are absolute: tick k is due k tick durations after the start, so errors do not accumulate, and a late run
catches up. The wait is clock_nanosleep(2) with TIMER_ABSTIME on the monotonic clock, so an interruption between
reading the clock and waiting does not shift a deadline.
"""

import ctypes
import math
import time
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from twin.kernel.compiled.function import carray, njit, pointer_to
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.component import c_function
from twin.kernel.cosim.histogram import Histogram, count_in
from twin.kernel.cosim.port import memory_of, record

MIN_WAIT = 1e-3
"""Minimum wall time between two deadlines (s), so that the overshoot of a sleep is small in comparison."""
TIMER_ABSTIME, NS_PER_SECOND = 1, 10**9
DEADLINE_RECORD = record(
    advance="i8",  # address of the function that runs ticks
    loop="i8",  # address of its memory
    clock="i8",  # address of clock_gettime
    sleep="i8",  # address of clock_nanosleep
    clock_id="i8",
    time="i8",  # address of a struct timespec
    start="i8",  # first tick, which has no deadline; -1 before it
    begun="i8",  # time of tick 0 (ns)
    tick="f8",  # duration of a tick (ns)
    every="i8",  # ticks between two deadlines
    last="i8",  # tick of the last deadline
    count="i8",  # number of deadlines
    missed="i8",  # number of missed deadlines
    worst="f8",  # largest lateness of a missed deadline (s)
    newest="f8",  # lateness at the last deadline (s)
    largest="f8",  # largest lateness (s)
    sum="f8",  # sum of lateness (s)
    squares="f8",  # sum of squared lateness (s^2)
    waited="f8",  # time spent waiting (s)
    bins="i8",  # address of the histogram of lateness
)
"""Memory of the pacing: functions, schedule and statistics."""

_deadlines_at, _times_at = pointer_to(DEADLINE_RECORD), pointer_to(np.int64)


@cache
def clock_functions() -> tuple[Any, ...]:
    """Return C's clock_gettime and clock_nanosleep, or replacements in Python, and the monotonic clock's number."""
    library = ctypes.CDLL(None)
    if hasattr(library, "clock_nanosleep"):
        return library.clock_gettime, library.clock_nanosleep, time.CLOCK_MONOTONIC
    return (*callbacks(time.monotonic, time.sleep), 0)


def callbacks(monotonic: Any, sleep: Any) -> tuple[Any, Any]:
    """Make C replacements of clock_gettime and clock_nanosleep from functions with the signatures of `time`."""
    timespec = ctypes.POINTER(ctypes.c_int64)

    @ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int, timespec)
    def clock(number: int, at: Any) -> int:
        at[0], at[1] = divmod(round(monotonic() * NS_PER_SECOND), NS_PER_SECOND)
        return 0

    @ctypes.CFUNCTYPE(ctypes.c_int, ctypes.c_int, ctypes.c_int, timespec, ctypes.c_void_p)
    def sleep_until(number: int, flags: int, until: Any, rest: int) -> int:
        sleep(max(0.0, until[0] + until[1] / NS_PER_SECOND - monotonic()))
        return 0

    return clock, sleep_until


_clock_call = c_function("int", "int", "pointer")
_sleep_call = c_function("int", "int", "int", "pointer", "pointer")
_advance_call = c_function("size", "size", "size", "size", "size")


@njit(cache=True)
def _clock_ns(m):
    """Read the monotonic clock (ns)."""
    _clock_call(m.clock, (m.clock_id, m.time))
    at = carray(_times_at(m.time), 2)
    return at[0] * NS_PER_SECOND + at[1]


@njit(cache=True)
def _wait_until_due(m, k):
    """Wait until tick `k` is due in real time and record the lateness; return False if a signal interrupted the wait.

    The caller then returns to Python, which handles the signal.
    """
    due = m.begun + np.int64(np.rint(k * m.tick))
    now = _clock_ns(m)
    if now < due:
        at = carray(_times_at(m.time), 2)
        at[0], at[1] = due // NS_PER_SECOND, due % NS_PER_SECOND
        interrupted = _sleep_call(m.sleep, (m.clock_id, TIMER_ABSTIME, m.time, 0)) != 0
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
    """Run ticks of the simulation loop, none before its deadline in real time; return fewer rows after a signal."""
    m = carray(_deadlines_at(deadlines), 1)[0]
    if m.start < 0 and count > 0:
        m.start, m.begun = first, _clock_ns(m) - np.int64(np.rint(first * m.tick))
    done = 0
    while done < count:
        k = first + done
        if k % m.every == 0 and k > m.start and not _wait_until_due(m, k):
            return done
        most = min(m.every - k % m.every, count - done)
        made = _advance_call(m.advance, (m.loop, k, most, row + done))
        if made < 0:
            return made - done
        done += made
        if made < most:
            return done
    return done


class Deadlines:
    """Pacing of a simulation in real time: deadlines of the ticks, and statistics of lateness.

    `tick` is the wall time of a tick, and `shortest` the minimum between two deadlines (s), > 0; `functions` is the
    result of `clock_functions`. `lateness` is the time from a deadline to the start of its tick.
    """

    def __init__(self, tick: float, functions: tuple[Any, ...], shortest: float = MIN_WAIT):
        *self._functions, number = functions
        clock, sleep = (ctypes.cast(one, ctypes.c_void_p).value for one in self._functions)
        self._time = np.zeros(2, dtype=np.int64)
        self.lateness = Histogram()
        every = max(1, math.ceil(shortest / tick - 1e-9))
        self.memory = memory_of(
            DEADLINE_RECORD, clock=clock, sleep=sleep, clock_id=number, time=self._time.ctypes.data, start=-1,
            tick=tick * NS_PER_SECOND, every=every, bins=self.lateness.bins.ctypes.data,
        )  # fmt: skip
        self.address = self.memory.ctypes.data

    def paced_advance(self, ticks: Any, loop: int) -> Callable[[int, int, int, int], int]:
        """Return the function that runs ticks in real time, calling the C function `ticks` with address `loop`."""
        self.memory["advance"], self.memory["loop"] = ctypes.cast(ticks, ctypes.c_void_p).value, loop
        found: Callable[[int, int, int, int], int] = advance.native.c_function
        return found

    @property
    def counts(self) -> dict[str, float]:
        """Statistics of the real-time pacing so far, by the field names of `DEADLINE_RECORD`."""
        found = dict(zip(DEADLINE_RECORD.names or (), self.memory[0].item(), strict=True))
        self.lateness.largest = found["largest"]
        return found
