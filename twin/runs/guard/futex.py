"""A word in shared memory that one process sets and another waits for, from compiled code.

The waiter sleeps in the kernel (futex(2)); the setter wakes it only if it sleeps. Whoever is about to sleep says so
before it looks for the last time, and the setter looks for sleepers after it has set the word; both orders are
sequentially consistent, so one of the two sees the other.

Nobody looks twice before sleeping: the two sides take turns on one processor (see `isolated_drive.py`), where looking
would only keep the other from running.
"""

import ctypes
import platform
import sys

import numpy as np

from twin.compiled.function import c, carray, intrinsic, ir, njit, pointer_to, types
from twin.errors import InputRefused

_NUMBERS = {"x86_64": (202, 247, 228), "aarch64": (98, 95, 113)}
"""By processor: numbers of the system calls futex, waitid and clock_gettime (asm/unistd_64.h, asm-generic/unistd.h)."""
_WAIT, _WAKE = 0, 1
_P_PID, _WEXITED_WNOHANG_WNOWAIT = 1, 4 | 1 | 0x01000000
_integers = pointer_to(np.int64)


def kernel() -> np.ndarray:
    """How compiled code reaches the kernel: address of libc's `syscall`, numbers of futex, waitid and clock_gettime,
    (4,) int64.

    Raises:
        InputRefused: this system has none.
    """
    if sys.platform != "linux" or platform.machine() not in _NUMBERS:
        raise InputRefused(
            f"drives in processes of their own need Linux on {' or '.join(_NUMBERS)}, this is {sys.platform} on "
            f"{platform.machine()}; use --isolate run, and drives of which a process can hold three"
        )
    syscall = ctypes.cast(ctypes.CDLL(None).syscall, ctypes.c_void_p).value
    return np.array([syscall, *_NUMBERS[platform.machine()]], dtype=np.int64)


@intrinsic
def load(typingctx, address):
    """The int32 at `address`, sequentially consistent."""

    def codegen(context, builder, signature, arguments):
        return builder.load_atomic(builder.inttoptr(arguments[0], c.i32.as_pointer()), "seq_cst", 4)

    return types.int32(types.int64), codegen


@intrinsic
def store(typingctx, address, value):
    """Set the int32 at `address`, sequentially consistent."""

    def codegen(context, builder, signature, arguments):
        builder.store_atomic(arguments[1], builder.inttoptr(arguments[0], c.i32.as_pointer()), "seq_cst", 4)
        return context.get_dummy_value()

    return types.void(types.int64, types.int32), codegen


@intrinsic
def _syscall(typingctx, function, number, first, second, third, fourth, fifth):
    """`long syscall(long number, ...)` with five arguments."""

    def codegen(context, builder, signature, arguments):
        kind = ir.FunctionType(c.i64, [c.i64] * 6)
        return builder.call(builder.inttoptr(arguments[0], kind.as_pointer()), arguments[1:])

    return types.int64(*[types.int64] * 7), codegen


@njit(cache=True, nogil=True)
def tell(kernel, word, asleep, value):
    """Set `word` to `value` and wake who waits for it.

    Args:
        kernel: address of what `kernel` returns.
        word, asleep: addresses of int32: what is set, and whether somebody sleeps on it.
    """
    store(word, value)
    if load(asleep) != 0:
        store(asleep, 0)
        call = carray(_integers(kernel), 4)
        _syscall(call[0], call[1], word, _WAKE, 1, 0, 0)


@njit(cache=True, nogil=True)
def seen(kernel, word, asleep, value, patience):
    """Whether `word` is `value`, or became it while this slept once.

    Args:
        patience: address of a `struct timespec`, how long to sleep. The rest as for `tell`.
    """
    present = load(word)
    if present == value:
        return True
    store(asleep, 1)
    if load(word) == present:
        call = carray(_integers(kernel), 4)
        _syscall(call[0], call[1], word, _WAIT, present, patience, 0)
    store(asleep, 0)
    return load(word) == value


@njit(cache=True, nogil=True)
def has_ended(kernel, pid, info):
    """Whether the child process `pid` has ended; it can still be waited for.

    Args:
        info: address of 128 bytes for a `siginfo_t`, whose first int is the signal if there was news.
    """
    call = carray(_integers(kernel), 4)
    carray(_integers(info), 1)[0] = 0
    _syscall(call[0], call[2], _P_PID, pid, info, _WEXITED_WNOHANG_WNOWAIT, 0)
    return carray(_integers(info), 1)[0] != 0


@njit(cache=True, nogil=True)
def time_of(kernel, clock, info):
    """Of a clock (s); 0 if there is no such clock.

    Args:
        info: address of 16 bytes for a `struct timespec`.
    """
    call, told = carray(_integers(kernel), 4), carray(_integers(info), 2)
    told[0] = told[1] = 0
    _syscall(call[0], call[3], clock, info, 0, 0, 0)
    return told[0] + 1e-9 * told[1]


def timespec(seconds: float) -> np.ndarray:
    """`struct timespec` of a 64-bit system: (2,) int64, seconds and nanoseconds."""
    return np.array([int(seconds), round(1e9 * (seconds % 1.0))], dtype=np.int64)
