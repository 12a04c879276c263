"""Stepping of a component in another process, through shared memory.

The page follows the black box of the component's process, at the offset where a run has its inputs: four words and the
status, one cache line for each side; then t and h, the inputs, the outputs. One word signals a request, one the answer.

A waiter sleeps in the kernel (futex(2)), and the setter of a word wakes it only if it sleeps. A side marks that it is
about to sleep before its last check of the word, and the setter checks for sleepers after setting the word; both orders
are sequentially consistent, so at least one side sees the other.

Neither side spins before sleeping: both share one processor (see `isolated_drive.py`), where spinning would only keep
the other from running.
"""

import ctypes
import mmap
import os
import platform
import struct
import sys

import numpy as np

from twin.kernel.compiled.function import c, carray, intrinsic, njit, pointer_to, types
from twin.kernel.compiled.native import entry
from twin.kernel.cosim.component import c_function, call_step, doubles_at, step_function
from twin.kernel.errors import InputRefused
from twin.kernel.process.black_box import INPUTS_AT
from twin.kernel.process.job import MAX_WAIT_RATIO

_SYSCALL_NUMBERS = {"x86_64": (202, 247, 228), "aarch64": (98, 95, 113)}
"""Processor -> numbers of the system calls futex, waitid and clock_gettime (asm/unistd_64.h, asm-generic/unistd.h)."""
_FUTEX_WAIT, _FUTEX_WAKE = 0, 1
_CLOCK_MONOTONIC = 1
_P_PID, _WEXITED_WNOHANG_WNOWAIT = 1, 4 | 1 | 0x01000000
_integers = pointer_to(np.int64)
ASKED_OFFSET, HOST_ASLEEP_OFFSET, CLOSED_OFFSET = INPUTS_AT, INPUTS_AT + 4, INPUTS_AT + 8
ANSWERED_OFFSET, CALLER_ASLEEP_OFFSET, STATUS_OFFSET = INPUTS_AT + 64, INPUTS_AT + 68, INPUTS_AT + 72
_TIME_OFFSET, _INPUTS_OFFSET = INPUTS_AT + 128, INPUTS_AT + 144
SLEEP_INTERVAL = 0.02
"""Maximum time (s) that either side sleeps before it checks whether the other is alive."""
HOST_DIED, HOST_STUCK = 1 << 20, 1 << 21
"""Statuses of the caller's step: the host has ended, or did not answer in time. No component returns them."""
SERVE_IDLE, SERVE_STOPPED, SERVE_ORDERED = 1 << 22, 1 << 23, 1 << 24
"""Return values of `serve` besides statuses: no request for a while, page closed, or an order, i.e. a request with
`NO_STEP` as the step and the order's number as the time."""
NO_STEP = -1.0
CALLER_TYPE = np.dtype(
    [(name, "i8") for name in ("page", "inputs", "outputs", "number", "naps", "nap", "kernel", "pid", "clock", "info")],
    align=True,
)
"""Memory of the caller's step: address of the page; numbers of inputs and outputs; number of the last request; maximum
sleeps until the host counts as stuck, if it was on a processor for as long, else `MAX_WAIT_RATIO` times as many;
address of their duration; see `syscall_numbers` and `is_zombie`; pid of the host, and its processor-time clock."""
_i32 = pointer_to(np.int32)


def syscall_numbers() -> np.ndarray:
    """Return the address of libc's `syscall` and the numbers of futex, waitid and clock_gettime, (4,) int64.

    Raises:
        InputRefused: not Linux, or another processor.
    """
    if sys.platform != "linux" or platform.machine() not in _SYSCALL_NUMBERS:
        raise InputRefused(
            f"drives in processes of their own need Linux on {' or '.join(_SYSCALL_NUMBERS)}, this is {sys.platform} "
            f"on {platform.machine()}; use --isolate run, and drives that allow three instances per process"
        )
    syscall = ctypes.cast(ctypes.CDLL(None).syscall, ctypes.c_void_p).value
    return np.array([syscall, *_SYSCALL_NUMBERS[platform.machine()]], dtype=np.int64)


@intrinsic
def load(typingctx, address):
    """Load the int32 at a memory address shared between processes, sequentially consistent."""

    def codegen(context, builder, signature, arguments):
        return builder.load_atomic(builder.inttoptr(arguments[0], c.i32.as_pointer()), "seq_cst", 4)

    return types.int32(types.int64), codegen


@intrinsic
def store(typingctx, address, value):
    """Store an int32 at a memory address shared between processes, sequentially consistent."""

    def codegen(context, builder, signature, arguments):
        builder.store_atomic(arguments[1], builder.inttoptr(arguments[0], c.i32.as_pointer()), "seq_cst", 4)
        return context.get_dummy_value()

    return types.void(types.int64, types.int32), codegen


_syscall = c_function("size", *["size"] * 6)
"""System call `long syscall(long number, ...)` with five arguments, at an address."""


@njit(cache=True, nogil=True)
def set_and_wake(kernel, word, asleep, value):
    """Set a shared word to `value` and wake the process that waits for it.

    `kernel` is the address of the result of `syscall_numbers`; `word` and `asleep` (whether a process sleeps on the
    word) are addresses of int32.
    """
    store(word, value)
    if load(asleep) != 0:
        store(asleep, 0)
        call = carray(_integers(kernel), 4)
        _syscall(call[0], (call[1], word, _FUTEX_WAKE, 1, 0, 0))


@njit(cache=True, nogil=True)
def wait_once(kernel, word, asleep, value, patience):
    """Whether a shared word has the value `value`, after sleeping at most once until it changes; see `set_and_wake`.

    `patience` is the address of a `struct timespec`, the maximum time to sleep.
    """
    present = load(word)
    if present == value:
        return True
    store(asleep, 1)
    if load(word) == present:
        call = carray(_integers(kernel), 4)
        _syscall(call[0], (call[1], word, _FUTEX_WAIT, present, patience, 0))
    store(asleep, 0)
    return load(word) == value


@njit(cache=True, nogil=True)
def is_zombie(kernel, pid, info):
    """Whether the child process `pid` has ended, without reaping it.

    `info` is the address of 128 bytes for a `siginfo_t`; its first int is the signal number if the child has ended.
    """
    call = carray(_integers(kernel), 4)
    carray(_integers(info), 1)[0] = 0
    _syscall(call[0], (call[2], _P_PID, pid, info, _WEXITED_WNOHANG_WNOWAIT, 0))
    return carray(_integers(info), 1)[0] != 0


@njit(cache=True, nogil=True)
def clock_ns(kernel, clock, info):
    """Return the time of a clock (ns), 0 if it does not exist; `info` is the address of 16 bytes for a `timespec`."""
    call, times = carray(_integers(kernel), 4), carray(_integers(info), 2)
    times[0] = times[1] = 0
    _syscall(call[0], (call[3], clock, info, 0, 0, 0))
    return times[0] * 1_000_000_000 + times[1]


@njit(cache=True, nogil=True)
def monotonic_ns(kernel, info):
    """Return the time of the monotonic clock (ns); arguments as in `clock_ns`."""
    return clock_ns(kernel, _CLOCK_MONOTONIC, info)


def timespec(seconds: float) -> np.ndarray:
    """Return a `struct timespec` of a 64-bit system, (2,) int64: seconds and nanoseconds."""
    return np.array([int(seconds), round(1e9 * (seconds % 1.0))], dtype=np.int64)


class SharedPage:
    """Mapping of a memory page that this process shares with another, to exchange a component's inputs and outputs.

    `fd` is the file descriptor of the black box, `inputs` and `outputs` are numbers of doubles; byte 0 is at `address`.
    `number` (1,) is the number of the next request, for the host.
    """

    def __init__(self, fd: int, inputs: int, outputs: int):
        self._fd, self._end = fd, _INPUTS_OFFSET + 8 * (inputs + outputs)
        os.ftruncate(fd, max(self._end, os.fstat(fd).st_size))
        # the array keeps the mapping alive
        self._bytes = np.frombuffer(mmap.mmap(fd, self._end), dtype=np.uint8)
        self.address = self._bytes.ctypes.data
        self.inputs, self.outputs = inputs, outputs
        self.kernel, self.nap = syscall_numbers(), timespec(SLEEP_INTERVAL)
        self.number = np.ones(1, dtype=np.int64)

    def clear(self) -> None:
        """Reset the shared page after a previous drive; call in the host, before the first request."""
        self._bytes[INPUTS_AT:] = 0

    @property
    def order(self) -> int:
        """Number of the order that made `serve` return."""
        return int(self._bytes[_TIME_OFFSET : _TIME_OFFSET + 8].view(np.float64)[0])

    def write_content(self, content: bytes) -> None:
        """Store bytes behind the shared page for the other process's `read_content`; replaces earlier content."""
        os.pwrite(self._fd, struct.pack("<Q", len(content)) + content, self._end)

    def read_content(self) -> bytes:
        """Read the bytes that the other process stored behind the shared page."""
        (length,) = struct.unpack("<Q", os.pread(self._fd, 8, self._end))
        return os.pread(self._fd, length, self._end + 8)

    def answer(self, status: int) -> None:
        """Answer an order that interrupted `serve` with `status`; call in the host."""
        answer(self.address, status, self.number, self.kernel.ctypes.data)

    def close(self) -> None:
        """Close the shared page, so that the host's `serve` returns SERVE_STOPPED."""
        self._bytes[CLOSED_OFFSET] = 1


@njit(cache=True, inline="always")
def next_number(number):
    # a word has 31 bits for the number
    return (number + 1) & 0x7FFFFFFF


@step_function(CALLER_TYPE)
def ask(m, t, h, u, y):
    """Step a component that runs in the host process: pass its inputs and wait for its outputs."""
    page = m.page
    times = carray(doubles_at(page + _TIME_OFFSET), 2)
    there = carray(doubles_at(page + _INPUTS_OFFSET), m.inputs + m.outputs)
    u_, y_ = carray(u, m.inputs), carray(y, m.outputs)
    times[0], times[1] = t, h
    for j in range(m.inputs):
        there[j] = u_[j]
    m.number = next_number(m.number)
    set_and_wake(m.kernel, page + ASKED_OFFSET, page + HOST_ASLEEP_OFFSET, m.number)
    naps, used = 0, 0
    while not wait_once(m.kernel, page + ANSWERED_OFFSET, page + CALLER_ASLEEP_OFFSET, m.number, m.nap):
        naps += 1
        if is_zombie(m.kernel, m.pid, m.info):
            return HOST_DIED
        if naps == 1:
            used = clock_ns(m.kernel, m.clock, m.info)
        # the first sleep is not counted
        if naps > m.naps and (
            naps > MAX_WAIT_RATIO * m.naps
            or 1e-9 * (clock_ns(m.kernel, m.clock, m.info) - used) > SLEEP_INTERVAL * (m.naps - 1)
        ):
            return HOST_STUCK
    for j in range(m.outputs):
        y_[j] = there[m.inputs + j]
    return carray(_i32(page + STATUS_OFFSET), 1)[0]


@entry("int", "int", "int", "int", "int", "integers", "int", "int")
def serve(page, inputs, step, memory, numbers, kernel, nap):
    """Serve step requests of another process from `numbers[0]` on, until a bad status, an order, or a long pause.

    `page`, `step`, `memory`, `kernel` and `nap` are addresses: of the page, the component's step and memory, and the
    results of `syscall_numbers` and `timespec`. Returns the status, SERVE_IDLE, SERVE_STOPPED or SERVE_ORDERED;
    `numbers[0]` is then the number of the next request, or of the order to be answered.
    """
    number = carray(numbers, 1)
    times = carray(doubles_at(page + _TIME_OFFSET), 2)
    while True:
        if not wait_once(kernel, page + ASKED_OFFSET, page + HOST_ASLEEP_OFFSET, number[0], nap):
            return SERVE_STOPPED if carray(_i32(page + CLOSED_OFFSET), 1)[0] else SERVE_IDLE
        if times[1] == NO_STEP:
            return SERVE_ORDERED
        u = page + _INPUTS_OFFSET
        status = call_step(step, (memory, times[0], times[1], u, u + 8 * inputs))
        answer(page, status, numbers, kernel)
        if status != 0 and status != 1:
            return status


@entry("nothing", "int", "int", "integers", "int")
def answer(page, status, numbers, kernel):
    """Answer step request number `numbers[0]` of another process with `status`; arguments as in `serve`."""
    number = carray(numbers, 1)
    carray(_i32(page + STATUS_OFFSET), 1)[0] = status
    set_and_wake(kernel, page + ANSWERED_OFFSET, page + CALLER_ASLEEP_OFFSET, number[0])
    number[0] = next_number(number[0])
