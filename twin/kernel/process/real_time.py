"""A process that the operating system lets go first, as far as it is allowed to."""

import ctypes
import errno
import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

RECEIVER_PRIORITY, WORKER_PRIORITY = 20, 10
"""Priorities under SCHED_FIFO of who waits for messages, and of who works on them."""
SWITCH_INTERVAL = 2e-5
"""s after which a thread that waits for the interpreter gets it, of two on one processor; Python's own is 5 ms."""
PARALLEL_SWITCH_INTERVAL = 1e-4
"""Of two that may run at the same time, and so interrupt each other."""
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4
"""Of mlockall(2). What has been used once stays in memory; what is only reserved takes none."""


@contextmanager
def real_time(first: int | None = None) -> Iterator[str]:
    """Within the block this process goes before others, its memory stays where it is, and its threads take turns soon.

    All threads that there are now go first, the one that calls this second, and those that begin later last. The thread
    `first` has the processor of the one that calls: as long as it has work the other one does not run, and so does not
    ask for the interpreter either.

    Args:
        first: number of a thread of Python's that is not to wait for the one that calls.

    Yields:
        What is not allowed here, as a sentence; "" if all is.
    """
    turns = sys.getswitchinterval()
    refused = [why for why in (_raise_priority(), _lock_memory()) if why]
    # what there is by now stays: a search through all of it takes tens of milliseconds
    gc.collect()
    gc.freeze()
    processors = _share_processor(first) if first and not refused else set()
    sys.setswitchinterval(SWITCH_INTERVAL if processors else PARALLEL_SWITCH_INTERVAL)
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


def _share_processor(first: int) -> set[int]:
    """Let the thread `first` and this one have a processor; those that this one had."""
    processors = os.sched_getaffinity(0)
    for thread in (first, 0):
        # it may be over
        with suppress(ProcessLookupError):
            # the first processor has most interrupts
            os.sched_setaffinity(thread, {max(processors)})
    return processors


def _threads() -> list[int]:
    return [int(one.name) for one in Path("/proc/self/task").iterdir()]


def _raise_priority() -> str:
    if sys.platform != "linux":
        return f"SCHED_FIFO is not known on {sys.platform}"
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        for thread in _threads():
            with suppress(ProcessLookupError):
                os.sched_setscheduler(thread, policy, os.sched_param(RECEIVER_PRIORITY))
        os.sched_setscheduler(0, policy, os.sched_param(WORKER_PRIORITY))
    except PermissionError:
        return "SCHED_FIFO is not allowed (CAP_SYS_NICE or ulimit -r 20)"
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
