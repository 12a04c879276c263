"""Mailbox between a running simulation and another process: a ring of samples one way, a ring of commands back.

Both rings are in memory that the two processes share. Each has one writer, which never waits, and readers with read
positions of their own, which never change the ring. An entry is written before the ring's count, and the count is
sequentially consistent; so a reader sees whole entries. A reader that is more than `CAPACITY` entries late loses the
oldest and counts them.

A reader in another process sleeps in the kernel (futex(2)) until the count changes, see `shared_memory.py`.
"""

import mmap
import os
import time
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from twin.kernel.compiled.function import carray, njit, pointer_to
from twin.kernel.compiled.native import address_of, entry
from twin.kernel.cosim.component import doubles_at
from twin.kernel.process.black_box import INPUTS_AT
from twin.kernel.process.shared_memory import (
    SLEEP_INTERVAL,
    load,
    monotonic_ns,
    set_and_wake,
    syscall_numbers,
    timespec,
    wait_once,
)

CAPACITY = 4096
"""Number of entries of a ring: 4 s at 1 kHz."""
OBEYED_TAG, IGNORED_TAG, GIVE_UP_TAG = 0, 1, 2
"""Tags of a command: to be obeyed, only recorded, or the end of a wait for an answer that does not come."""
HEAD_SIZE = 4
"""Number of integers at the front of an entry: number (from 1), tick, time (ns, monotonic clock), tag."""
_COUNT_MASK = 0x7FFFFFFF
"""Mask of an entry's number in the futex word of a ring, which has 31 bits."""
_ASLEEP_OFFSET, _ENTRIES_OFFSET = 64, 128
"""Offsets in a ring, in cache lines of their own: whether a reader sleeps, first entry. The count is at 0."""
_CLOSED_OFFSET, _RINGS_OFFSET = INPUTS_AT, INPUTS_AT + 64
"""Offsets in the shared memory, behind the black box of a process."""
_integers_at = pointer_to(np.int64)


@njit(cache=True, nogil=True)
def entry_address(ring, values, number):
    """Return the address of entry `number` (from 1) of the ring at an address, whose entries have `values` doubles."""
    return ring + _ENTRIES_OFFSET + ((number - 1) % CAPACITY) * 8 * (HEAD_SIZE + values)


@njit(cache=True, nogil=True)
def unread_count(ring, number):
    """Return the number of entries of the ring at an address that follow entry `number`."""
    return (load(ring) - (number & _COUNT_MASK)) & _COUNT_MASK


@njit(cache=True, nogil=True)
def write_head(ring, values, number, tick, time, tag):
    """Write the head of entry `number`, and return the address of its values."""
    address = entry_address(ring, values, number)
    head = carray(_integers_at(address), HEAD_SIZE)
    head[0], head[1], head[2], head[3] = number, tick, time, tag
    return address + 8 * HEAD_SIZE


@njit(cache=True, nogil=True)
def publish_entry(kernel, ring, number):
    """Make entry `number` visible to the readers of a ring, and wake one that sleeps."""
    set_and_wake(kernel, ring, ring + _ASLEEP_OFFSET, number & _COUNT_MASK)


@njit(cache=True, nogil=True)
def wait_for_entry(kernel, ring, number, patience):
    """Whether a ring has entries after entry `number`, after sleeping at most once; see `wait_once`."""
    if unread_count(ring, number) > 0:
        return True
    wait_once(kernel, ring, ring + _ASLEEP_OFFSET, (number + 1) & _COUNT_MASK, patience)
    return unread_count(ring, number) > 0


@entry("nothing", "int", "int", "int", "int", "int", "int", "int", "doubles")
def _put(kernel, info, ring, number, tick, tag, values, source):
    """Write entry `number` with `values` doubles from `source`."""
    address = write_head(ring, values, number, tick, monotonic_ns(kernel, info), tag)
    there, given = carray(doubles_at(address), values), carray(source, values)
    for j in range(values):
        there[j] = given[j]
    publish_entry(kernel, ring, number)


@entry("int", "int", "int", "int", "int")
def _wait(kernel, ring, number, patience):
    return 1 if wait_for_entry(kernel, ring, number, patience) else 0


class MailboxEntry(NamedTuple):
    """An entry of a ring; its number counts from 1, its values (n,) are a copy.

    Attributes:
        tick: tick of a sample, or tick that a command answers; -1 for no tick.
        time: time at which it was written, or deadline of a sample's tick (ns, monotonic clock).
        tag: tag of a command, see `OBEYED_TAG`; for a sample, the number of the last command that took effect.
    """

    number: int
    tick: int
    time: int
    tag: int
    values: NDArray[np.float64]


class SharedRing:
    """A ring of entries of `values` doubles in shared memory at `address`, with the position of one writer or reader.

    `number` counts the last entry written or read here; `lost` entries were overwritten before they were read here.
    """

    def __init__(self, memory: NDArray[np.uint8], values: int):
        self._memory, self.values = memory, values
        self.address = memory.ctypes.data
        self.number = self.lost = 0
        self._kernel, self._info = syscall_numbers(), np.zeros(2, dtype=np.int64)
        # loaded here: the first call would hold the GIL for tens of milliseconds, while the ring is in use
        self._write_entry, self._wait_for_entry = _put.native.c_function, _wait.native.c_function
        entries = memory[_ENTRIES_OFFSET : ring_size(values)].view(np.int64).reshape(CAPACITY, HEAD_SIZE + values)
        self._heads, self._values = entries[:, :HEAD_SIZE], entries.view(np.float64)[:, HEAD_SIZE:]
        self._count = memory[:4].view(np.int32)

    @property
    def unread_entries(self) -> int:
        """Number of entries after the last one read here."""
        return int(self._count[0]) - (self.number & _COUNT_MASK) & _COUNT_MASK

    def put(self, tick: int, values: ArrayLike, tag: int = OBEYED_TAG) -> int:
        """Append an entry to the ring, wake its reader, and return the entry's number; for the only writer."""
        self.number += 1
        given = np.array(values, dtype=np.float64)
        if given.shape != (self.values,):
            raise ValueError(f"values of shape {given.shape}, expected ({self.values},)")
        kernel, info = address_of(self._kernel), address_of(self._info)
        self._write_entry(kernel, info, self.address, self.number, tick, tag, self.values, address_of(given))
        return self.number

    def pop(self, timeout: float = 0.0) -> MailboxEntry | None:
        """Read the next entry of the ring; None if there is none within `timeout` (s). A wait releases the GIL."""
        deadline = time.monotonic() + timeout
        while not self.unread_entries:
            left = deadline - time.monotonic()
            if left <= 0.0:
                return None
            patience = timespec(min(left, SLEEP_INTERVAL))
            self._wait_for_entry(address_of(self._kernel), self.address, self.number, address_of(patience))
        self._drop_overwritten()
        self.number += 1
        place = (self.number - 1) % CAPACITY
        number, tick, written, tag = self._heads[place].tolist()
        return MailboxEntry(number, tick, written, tag, self._values[place].copy())

    def pop_arrays(self) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Read all entries that are there now as arrays: number, tick, time and tag (n, 4), and values (n, width)."""
        self._drop_overwritten()
        places = (self.number + np.arange(self.unread_entries)) % CAPACITY
        self.number += len(places)
        return self._heads[places], self._values[places]

    def _drop_overwritten(self) -> None:
        behind = self.unread_entries - (CAPACITY - 1)
        if behind > 0:
            self.lost, self.number = self.lost + behind, self.number + behind


def ring_size(values: int) -> int:
    """Return the size of a ring (bytes) whose entries have `values` doubles."""
    return _ENTRIES_OFFSET + 8 * CAPACITY * (HEAD_SIZE + values)


class Mailbox:
    """Mailbox in the memory behind a black box: the simulation writes `samples`, the other process `commands`.

    `fd` is the file descriptor of the black box, see `GuardedProcess.box` and `PipeReporter.box`; `sample_values` and
    `command_values` are numbers of doubles.
    """

    def __init__(self, fd: int, sample_values: int, command_values: int):
        first = ring_size(sample_values)
        size = _RINGS_OFFSET + first + ring_size(command_values)
        if os.fstat(fd).st_size < size:
            os.ftruncate(fd, size)
        # the array keeps the mapping alive
        self._bytes = np.frombuffer(mmap.mmap(fd, size), dtype=np.uint8)
        self.samples = SharedRing(self._bytes[_RINGS_OFFSET : _RINGS_OFFSET + first], sample_values)
        self.commands = SharedRing(self._bytes[_RINGS_OFFSET + first :], command_values)

    @property
    def is_closed(self) -> bool:
        """Whether the simulation has ended, so that no sample follows."""
        return bool(self._bytes[_CLOSED_OFFSET])

    def close(self) -> None:
        """Mark the mailbox as closed; for the simulation."""
        self._bytes[_CLOSED_OFFSET] = 1
