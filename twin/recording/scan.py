"""The records of a recording's file, each checked before it is believed.

A finished file ends in two CRCs which together cover every byte but those of the closing magic. A file whose
writer was stopped has only the CRC of each chunk; what keeps its other bytes honest is that a chunk that went
missing leaves a gap in the sequence numbers. Its metadata is then the one thing under no check.
"""

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Chunk, DataEnd, Header, Metadata, Statistics
from mcap.writer import MCAP0_MAGIC

from twin.files import LIMIT
from twin.recording.chunks import allowance, encoded, unpacked
from twin.recording.messages import RECORD_PREFIX

# by opcode, all that `Writer` puts between the magics outside chunks, except indexes
READERS: dict[int, Callable[[ReadDataStream], Header | Chunk | Metadata | DataEnd]] = {
    Opcode.HEADER: Header.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.METADATA: Metadata.read,
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
            self.statistics = _statistics(ending)


def _statistics(ending: bytes) -> Statistics | None:
    """The record of that kind in the end of a file whose CRC is right."""
    place = 0
    while place + RECORD_PREFIX <= len(ending) - len(MCAP0_MAGIC):
        opcode, length = struct.unpack_from("<BQ", ending, place)
        place += RECORD_PREFIX + length
        if opcode == Opcode.STATISTICS:
            return Statistics.read(ReadDataStream(BytesIO(ending[place - length : place])))
    return None


def _parsed(position: int, opcode: int, body: bytes) -> Header | Chunk | Metadata | DataEnd:
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
