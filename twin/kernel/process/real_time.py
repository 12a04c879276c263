"""A process that the operating system lets go first, as far as it is allowed to."""

import ctypes
import errno
import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

FIRST, SECOND = 20, 10
"""Priorities under SCHED_FIFO of who waits for messages, and of who works on them."""
SWITCH = 1e-4
"""s after which a thread that waits for the interpreter gets it; Python's own is 5 ms."""
_CURRENT, _FUTURE, _ON_FAULT = 1, 2, 4
"""Of mlockall(2). What has been used once stays in memory; what is only reserved takes none."""


@contextmanager
def real_time() -> Iterator[str]:
    """Within the block this process goes before others, its memory stays where it is, and its threads take turns soon.

    All threads that there are now go first, the one that calls this second, and those that begin later last.

    Yields:
        What is not allowed here, as a sentence; "" if all is.
    """
    turns = sys.getswitchinterval()
    sys.setswitchinterval(SWITCH)
    # what there is by now stays: a search through all of it takes tens of milliseconds
    gc.collect()
    gc.freeze()
    refused = [why for why in (_go_first(), _lock_memory()) if why]
    try:
        yield f"not in real time: {'; '.join(refused)}" if refused else ""
    finally:
        _go_as_others()
        if hasattr(ctypes.CDLL(None), "munlockall"):
            ctypes.CDLL(None).munlockall()
        gc.unfreeze()
        sys.setswitchinterval(turns)


def _threads() -> list[int]:
    return [int(one.name) for one in Path("/proc/self/task").iterdir()]


def _go_first() -> str:
    if sys.platform != "linux":
        return f"SCHED_FIFO is not known on {sys.platform}"
    policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        for thread in _threads():
            os.sched_setscheduler(thread, policy, os.sched_param(FIRST))
        os.sched_setscheduler(0, policy, os.sched_param(SECOND))
    except PermissionError:
        return "SCHED_FIFO is not allowed (CAP_SYS_NICE or ulimit -r 20)"
    return ""


def _go_as_others() -> None:
    if sys.platform == "linux":
        for thread in _threads():
            if os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO:
                os.sched_setscheduler(thread, os.SCHED_OTHER, os.sched_param(0))


def _lock_memory() -> str:
    library = ctypes.CDLL(None, use_errno=True)
    if not hasattr(library, "mlockall"):
        return f"memory cannot be locked on {sys.platform}"
    if library.mlockall(_CURRENT | _FUTURE | _ON_FAULT) == 0:
        return ""
    why = errno.errorcode.get(ctypes.get_errno(), "")
    return f"memory cannot be locked, {why} (CAP_IPC_LOCK or ulimit -l unlimited)"
