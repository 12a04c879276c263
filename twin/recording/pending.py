"""Message records that wait for the chunk they go into."""

from typing import NamedTuple

import numpy as np

ROOM = 256 * 1024
"""Bytes to begin with: those of a slice."""


class Shape(NamedTuple):
    """Of a block of records: their channel, how many they are, and their length in bytes."""

    channel: int
    messages: int
    stride: int


class Pending:
    """Message records of several channels, one block after another in one memory.

    Attributes:
        shapes: of the blocks.
        times: of each block the log times, ns, (n,) int64, ascending.
        size: bytes of all records.
        address: where the first begins.
    """

    def __init__(self) -> None:
        self._hold(np.empty(ROOM, dtype=np.uint8))
        self.clear()

    def room(self, size: int) -> int:
        """Address at which the next block begins, with room for `size` bytes at least."""
        if self.size + size > len(self._memory):
            larger = np.empty(2 * (self.size + size), dtype=np.uint8)
            larger[: self.size] = self._memory[: self.size]
            self._hold(larger)
        return self.address + self.size

    def add(self, channel: int, times: np.ndarray, stride: int) -> None:
        """What has been written into the room is a block: a record of `stride` bytes for each of `times`."""
        self.shapes.append(Shape(channel, len(times), stride))
        self.times.append(times)
        self.size += len(times) * stride

    def put(self, channel: int, times: np.ndarray, records: np.ndarray) -> None:
        """Append a block of `records`, (n, stride) uint8."""
        self.room(records.size)
        self._memory[self.size : self.size + records.size] = records.reshape(-1)
        self.add(channel, times, records.shape[1])

    def clear(self) -> None:
        """Forget all blocks; their memory is used again."""
        self.shapes: list[Shape] = []
        self.times: list[np.ndarray] = []
        self.size = 0

    def _hold(self, memory: np.ndarray) -> None:
        self._memory, self.address = memory, memory.ctypes.data
