"""The records of an MCAP file, each checked before it is used.

A finished file ends in two CRCs which together cover every byte but those of the closing magic. A file whose writer was
stopped has only the CRC of each chunk; what keeps its other bytes honest is that a chunk that went missing leaves a gap
in the sequence numbers. Its metadata is then the one thing under no check.

From record to record through the content of a chunk, and what a topic has of them, by compiled code. Layout of the
records: https://mcap.dev/spec#records, of messages: `messages.py`.
"""

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import BinaryIO

import numpy as np
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Chunk, DataEnd, Header, Metadata, Statistics
from mcap.writer import MCAP0_MAGIC

from twin.kernel.compiled.function import carray, copy, njit
from twin.kernel.compiled.native import entry
from twin.kernel.files import LIMIT
from twin.kernel.recording.messages import HEAD_OFFSETS, HEAD_SIZE, RECORD_PREFIX, SEQUENCE_AT
from twin.kernel.recording.summary import allowance, encoded, unpacked

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


# by opcode, all that `Writer` puts between the magics outside chunks, except indexes
READERS: dict[int, Callable[[ReadDataStream], Header | Chunk | Metadata | Attachment | DataEnd]] = {
    Opcode.HEADER: Header.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.METADATA: Metadata.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.DATA_END: DataEnd.read,
}
LARGEST_RECORD = 64 * 2**20
"""Bytes, packed and unpacked; the largest that twin writes, a chunk, has a few hundred thousand. To go through the
records of a chunk takes five times as many."""
# CRC of the summary and closing magic, the last bytes of a finished file
CRC_AND_MAGIC = 4 + len(MCAP0_MAGIC)


@dataclass(eq=False)
class Damage(Exception):
    """Bytes that are not what was written.

    Attributes:
        position: offset in the file of the record that holds them.
        reason: half a sentence.
    """

    position: int
    reason: str


@dataclass
class Scan:
    """Reads the records of a file in their order.

    Attributes:
        complete: after `contents` is exhausted, whether the file ended as a finished one does.
        rest: bytes at the end that make no complete record.
        statistics: what the file says at its end that it holds; None: it does not, or is not complete.
        position: offset of the end of what has been read.
    """

    file: BinaryIO
    complete: bool = False
    rest: int = 0
    statistics: Statistics | None = None
    position: int = 0

    def contents(self) -> Iterator[tuple[int, bytes | Metadata]]:
        """Checked contents of the chunks and metadata records, each after its record's offset in the file.

        Ends where an unfinished file ends.

        Raises:
            Damage: the first record that fails a check.
        """
        size = self.file.seek(0, os.SEEK_END)
        self.file.seek(max(0, size - len(MCAP0_MAGIC)))
        # of a file that ends with its first bytes these are no last ones
        finished = self.file.read() == MCAP0_MAGIC and size > len(MCAP0_MAGIC)
        self.file.seek(0)
        crc = zlib.crc32(self.file.read(len(MCAP0_MAGIC)))
        position = len(MCAP0_MAGIC)
        most, metadata = allowance(size), 0
        while True:
            self.position = position
            prefix = self.file.read(RECORD_PREFIX)
            opcode, length = struct.unpack("<BQ", prefix) if len(prefix) == RECORD_PREFIX else (0, size)
            end = position + RECORD_PREFIX + length
            if end > size:
                if finished:
                    raise Damage(position, "a record is longer than the file")
                self.rest = size - position
                return
            if length > LARGEST_RECORD:
                raise Damage(position, f"a record of {length / 1e6:.0f} MB where twin writes none of that size")
            body = self.file.read(length)
            if opcode == Opcode.DATA_END:
                if _parsed(position, opcode, body) != DataEnd(crc):
                    raise Damage(position, "its CRC fails though no chunk's does, so metadata may be wrong")
                self._check_summary(end)
                return
            crc = zlib.crc32(body, zlib.crc32(prefix, crc))
            if opcode != Opcode.MESSAGE_INDEX:
                record = _parsed(position, opcode, body)
                if isinstance(record, Chunk):
                    content = _content(position, record, most)
                    most -= len(content)
                    yield position, content
                elif isinstance(record, Metadata):
                    metadata += length
                    if metadata > LIMIT:
                        raise Damage(position, f"more than {LIMIT / 2**20:g} MB of metadata")
                    yield position, record
            position = end

    def _check_summary(self, position: int) -> None:
        ending = self.file.read()
        if not ending.endswith(MCAP0_MAGIC):
            self.rest = len(ending)
        elif zlib.crc32(ending[:-CRC_AND_MAGIC]).to_bytes(4, "little") != ending[-CRC_AND_MAGIC:][:4]:
            raise Damage(position, "its index fails its CRC")
        else:
            self.complete = True
            place = 0
            while place + RECORD_PREFIX <= len(ending) - len(MCAP0_MAGIC) and self.statistics is None:
                opcode, length = struct.unpack_from("<BQ", ending, place)
                place += RECORD_PREFIX + length
                if opcode == Opcode.STATISTICS:
                    self.statistics = Statistics.read(ReadDataStream(BytesIO(ending[place - length : place])))


def _parsed(position: int, opcode: int, body: bytes) -> Header | Chunk | Metadata | Attachment | DataEnd:
    """The record in `body`, which it fills exactly."""
    if opcode not in READERS:
        raise Damage(position, f"a record of kind {opcode} where twin writes none")
    try:
        record = READERS[opcode](ReadDataStream(BytesIO(body)))
    # a damaged length inside may be beyond what an index can hold
    except (McapError, struct.error, ValueError, OverflowError) as error:
        raise Damage(position, "a record that does not parse") from error
    # mcap's readers return what there is where a length inside points beyond the record
    if encoded(record)[RECORD_PREFIX:] != body:
        raise Damage(position, "a record that does not parse")
    return record


def _content(position: int, chunk: Chunk, most: int) -> bytes:
    """Decompressed content of `chunk`, of at most so many bytes, with the CRC it was written with."""
    try:
        if chunk.compression != "zstd":
            raise ValueError("a chunk that is not compressed by zstd")
        content = unpacked(chunk, most, LARGEST_RECORD)
    except ValueError as problem:
        raise Damage(position, str(problem)) from problem
    if zlib.crc32(content) != chunk.uncompressed_crc:
        raise Damage(position, "a chunk that fails its CRC")
    return content
