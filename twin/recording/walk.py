"""From record to record through the content of a chunk, and what a topic has of them, by compiled code.

Layout of the records: https://mcap.dev/spec#records, of messages: `messages.py`.
"""

import numpy as np
from mcap.opcode import Opcode

from twin.compiled.function import carray, njit
from twin.compiled.memory import copy
from twin.compiled.native import entry
from twin.recording.filling import SEQUENCE_AT
from twin.recording.messages import HEAD_OFFSETS, HEAD_SIZE, RECORD_PREFIX

PLACE, OPCODE, LENGTH, CHANNEL, SEQUENCE = range(5)
"""Columns of a table of records."""
LENGTH_AT, CHANNEL_AT = HEAD_OFFSETS[1:3]
MESSAGE_FRONT = HEAD_SIZE - RECORD_PREFIX
"""Channel, sequence number and two times: no message is shorter."""
MESSAGE = int(Opcode.MESSAGE)
OTHER_LENGTH, OTHER_SEQUENCE = 1, 2


@njit(cache=True)
def _number(content, at, size):
    """Of `size` bytes, the least significant first."""
    number = np.int64(0)
    for k in range(size):
        number |= np.int64(content[at + k]) << 8 * k
    return number


@entry("int", "bytes", "int", "integers")
def _walk(content, size, table):
    byte = carray(content, size)
    row = carray(table, ((size // RECORD_PREFIX + 1), 5))
    place = count = 0
    while place < size:
        if size - place < RECORD_PREFIX:
            return -1
        opcode, length = np.int64(byte[place]), _number(byte, place + LENGTH_AT, 8)
        # one beyond the integers is negative here
        if not 0 <= length <= size - place - RECORD_PREFIX:
            return -1
        whole = opcode == MESSAGE and length >= MESSAGE_FRONT
        row[count, PLACE], row[count, OPCODE], row[count, LENGTH] = place, opcode, length
        row[count, CHANNEL] = _number(byte, place + CHANNEL_AT, 2) if whole else -1
        row[count, SEQUENCE] = _number(byte, place + SEQUENCE_AT, 4) if whole else -1
        count += 1
        place += RECORD_PREFIX + length
    return count


@entry("int", "int", "integers", "int", "int", "int", "int", "int")
def _gather(content, table, count, channel, first_sequence, stride, gathered):
    row, found = carray(table, (count, 5)), 0
    for i in range(count):
        if row[i, CHANNEL] == channel:
            if row[i, LENGTH] != stride - RECORD_PREFIX:
                return OTHER_LENGTH
            if row[i, SEQUENCE] != first_sequence + found:
                return OTHER_SEQUENCE
            copy(gathered + found * stride, content + row[i, PLACE], stride)
            found += 1
    return 0


class Records:
    """The records in the content of a chunk.

    Args:
        content: bytes, which have to outlive this.

    Attributes:
        table: where they are, (n, 5) int64: place, opcode, length of what follows, and of messages channel and sequence
            number; -1 where there is none.

    Raises:
        ValueError: the last record is longer than what is there.
    """

    def __init__(self, content: bytes):
        self._content = np.frombuffer(content, dtype=np.uint8)
        room = np.empty((len(content) // RECORD_PREFIX + 1, 5), dtype=np.int64)
        # numpy takes as long to tell an address as it takes to gather
        self._addresses = self._content.ctypes.data, room.ctypes.data
        count = _walk(self._addresses[0], len(content), self._addresses[1])
        if count < 0:
            raise ValueError("a record that is longer than its chunk")
        self.table = room[:count]

    def of(self, channel: int, count: int, first_sequence: int, stride: int) -> np.ndarray | None:
        """The `count` records of `channel`, of `stride` bytes each, (count, stride) uint8.

        Args:
            first_sequence: sequence number from which they have to count.

        Returns:
            None: they do not.

        Raises:
            ValueError: they have another length.
        """
        content, table = self._addresses
        records = np.empty((count, stride), dtype=np.uint8)
        wrong = _gather(content, table, len(self.table), channel, first_sequence, stride, records)
        if wrong == OTHER_LENGTH:
            raise ValueError("messages whose length is not that of their schema")
        return None if wrong == OTHER_SEQUENCE else records
