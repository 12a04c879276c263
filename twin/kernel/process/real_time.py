"""Real-time scheduling of this process, as far as the operating system permits it."""

import ctypes
import errno
import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

SOURCE_PRIORITY, RECEIVER_PRIORITY, WORKER_PRIORITY = 40, 20, 10
"""SCHED_FIFO priorities of a served simulation, of threads that receive messages, and of threads that process them. The
simulation needs little time, and all others wait for it."""
HELPER_DISTANCE = 5
"""Difference of the SCHED_FIFO priorities of a thread and its helper."""
SWITCH_INTERVAL = 2e-5
"""Interpreter switch interval (s) of two threads on one processor; Python's default is 5 ms."""
PARALLEL_SWITCH_INTERVAL = 1e-4
"""Interpreter switch interval (s) of two threads that run in parallel and so interrupt each other."""
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
"""Flags of mlockall(2). Pages stay in memory once they have been used; reserved ones take no memory."""


@contextmanager
def real_time(
    first: int | None = None, priority: int = WORKER_PRIORITY, switch_interval: float = PARALLEL_SWITCH_INTERVAL
) -> Iterator[str]:
    """Run the block with real-time priority, locked memory and a short interpreter switch interval.

    Existing threads get SCHED_FIFO priority RECEIVER_PRIORITY, the calling thread `priority`; threads started later
    stay SCHED_OTHER. The Python thread with the native id `first`, if any, shares the caller's processor: while it has
    work the caller does not run, and so does not compete for the GIL; without it the interpreter switches threads after
    `switch_interval` (s). Yields why real time is not permitted, as a sentence; "" if it is.
    """
    turns = sys.getswitchinterval()
    refused = [why for why in (_raise_priority(priority), _lock_memory()) if why]
    # freeze existing objects: a collection through all of them takes tens of milliseconds
    gc.collect()
    gc.freeze()
    processors = _share_processor(first) if first and not refused else set()
    sys.setswitchinterval(SWITCH_INTERVAL if processors else switch_interval)
    try:
        yield f"not in real time: {'; '.join(refused)}" if refused else ""
    finally:
        _reset_priority()
        if processors:
            os.sched_setaffinity(0, processors)
        if hasattr(ctypes.CDLL(None), "munlockall"):
            ctypes.CDLL(None).munlockall()
        gc.unfreeze()
        sys.setswitchinterval(turns)


def share_priority(thread: int) -> None:
    """Give the thread `thread` (native id) a priority below the calling thread's if that has real-time priority.

    Other processes could keep a helper of normal priority that holds the GIL from running, and the caller with it.
    """
    if sys.platform == "linux" and os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO:
        with suppress(ProcessLookupError, PermissionError):
            lower = os.sched_param(os.sched_getparam(0).sched_priority - HELPER_DISTANCE)
            os.sched_setscheduler(thread, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, lower)


def _share_processor(first: int) -> set[int]:
    """Pin the thread `first` and this thread to one processor; return the processors allowed to this thread before."""
    processors = os.sched_getaffinity(0)
    for thread in (first, 0):
        # the thread may have ended
        with suppress(ProcessLookupError):
            # not the first processor, which handles most interrupts
            os.sched_setaffinity(thread, {max(processors)})
    return processors


def _threads() -> list[int]:
    return [int(one.name) for one in Path("/proc/self/task").iterdir()]


def _raise_priority(priority: int) -> str:
    if sys.platform != "linux":
        return f"SCHED_FIFO is not known on {sys.platform}"
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        for thread in _threads():
            with suppress(ProcessLookupError):
                os.sched_setscheduler(thread, policy, os.sched_param(RECEIVER_PRIORITY))
        os.sched_setscheduler(0, policy, os.sched_param(priority))
    except PermissionError:
        return f"SCHED_FIFO is not allowed (CAP_SYS_NICE or ulimit -r {max(priority, RECEIVER_PRIORITY)})"
    return ""


def _reset_priority() -> None:
    if sys.platform == "linux":
        for thread in _threads():
            with suppress(ProcessLookupError):
                if os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO:
                    os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))


def _lock_memory() -> str:
    library = ctypes.CDLL(None, use_errno=True)
    if not hasattr(library, "mlockall"):
        return f"memory cannot be locked on {sys.platform}"
    if library.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) == 0:
        return ""
    why = errno.errorcode.get(ctypes.get_errno(), "")
    return f"memory cannot be locked, {why} (CAP_IPC_LOCK or ulimit -l unlimited)"
