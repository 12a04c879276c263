"""Checked reading of the records of an MCAP file, and of the series and events in its chunks.

A finished file ends in two CRCs which together cover every byte but the closing magic. A file whose writer was stopped
has only the CRC of each chunk; a missing chunk leaves a gap in the sequence numbers, and only the metadata is then
unchecked.

Compiled code walks from record to record through the content of a chunk and collects the messages of each topic. Layout
of the records: https://mcap.dev/spec#records, of messages: `messages.py`.
"""

import os
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import BinaryIO

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Chunk, DataEnd, Header, Message, Metadata, Schema, Statistics
from mcap.writer import MCAP0_MAGIC

from twin.kernel.compiled.function import carray, copy, njit
from twin.kernel.compiled.native import entry
from twin.kernel.files import MAX_TEXT_BYTES
from twin.kernel.recording.messages import (
    HEAD_OFFSETS,
    HEAD_SIZE,
    RECORD_PREFIX,
    SEQUENCE_AT,
    Field,
    MessageLayout,
    check_stream,
    descriptor_fields,
    message_layout,
)
from twin.kernel.recording.summary import decompress_chunk, encode_record, unpack_allowance

PLACE_COLUMN, OPCODE_COLUMN, LENGTH_COLUMN, CHANNEL_COLUMN, SEQUENCE_COLUMN = range(5)
LENGTH_AT, CHANNEL_AT = HEAD_OFFSETS[1:3]
MESSAGE_FRONT = HEAD_SIZE - RECORD_PREFIX
"""Bytes of channel, sequence number and two times, the minimum length of a message."""
MESSAGE_OPCODE = int(Opcode.MESSAGE)
OTHER_LENGTH, OTHER_SEQUENCE = 1, 2
# by opcode, all record types that `Writer` writes between the magics outside chunks, except indexes
RECORD_READERS: dict[int, Callable[[ReadDataStream], Header | Chunk | Metadata | Attachment | DataEnd]] = {
    Opcode.HEADER: Header.read,
    Opcode.CHUNK: Chunk.read,
    Opcode.METADATA: Metadata.read,
    Opcode.ATTACHMENT: Attachment.read,
    Opcode.DATA_END: DataEnd.read,
}
MAX_RECORD_BYTES = 64 * 2**20
"""Maximum size of a record (bytes), compressed and decompressed; twin's largest, a chunk, has a few hundred thousand.
Walking the records of a chunk takes five times as much memory."""
# CRC of the summary and closing magic, the last bytes of a finished file
CRC_AND_MAGIC = 4 + len(MCAP0_MAGIC)
NS_PER_S = 1e9
# message types for viewers, whose numbers are all in the series too
FOREIGN_PREFIX = "foxglove."
MISSING_MESSAGES = "a chunk before which messages are missing"


@njit(cache=True)
def _little_endian(content, at, size):
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
        opcode, length = np.int64(byte[place]), _little_endian(byte, place + LENGTH_AT, 8)
        # a length of 2^63 or more is negative as int64
        if not 0 <= length <= size - place - RECORD_PREFIX:
            return -1
        whole = opcode == MESSAGE_OPCODE and length >= MESSAGE_FRONT
        row[count, PLACE_COLUMN], row[count, OPCODE_COLUMN], row[count, LENGTH_COLUMN] = place, opcode, length
        row[count, CHANNEL_COLUMN] = _little_endian(byte, place + CHANNEL_AT, 2) if whole else -1
        row[count, SEQUENCE_COLUMN] = _little_endian(byte, place + SEQUENCE_AT, 4) if whole else -1
        count += 1
        place += RECORD_PREFIX + length
    return count


@entry("int", "int", "integers", "int", "int", "int", "int", "int")
def _gather(content, table, count, channel, first_sequence, stride, gathered):
    row, found = carray(table, (count, 5)), 0
    for i in range(count):
        if row[i, CHANNEL_COLUMN] == channel:
            if row[i, LENGTH_COLUMN] != stride - RECORD_PREFIX:
                return OTHER_LENGTH
            if row[i, SEQUENCE_COLUMN] != first_sequence + found:
                return OTHER_SEQUENCE
            copy(gathered + found * stride, content + row[i, PLACE_COLUMN], stride)
            found += 1
    return 0


class Records:
    """The MCAP records in a chunk's content, which must outlive this object, located in a table.

    `table` is (n, 5) int64: offset, opcode, length of the body, and channel and sequence number of messages, -1 for
    other records. ValueError: the last record is longer than the remaining bytes.
    """

    def __init__(self, content: bytes):
        self._content = np.frombuffer(content, dtype=np.uint8)
        room = np.empty((len(content) // RECORD_PREFIX + 1, 5), dtype=np.int64)
        # stored because numpy's `ctypes.data` takes as long as the gathering itself
        self._addresses = self._content.ctypes.data, room.ctypes.data
        count = _walk(self._addresses[0], len(content), self._addresses[1])
        if count < 0:
            raise ValueError("a record that is longer than its chunk")
        self.table = room[:count]

    def channel_records(self, channel: int, count: int, first_sequence: int, stride: int) -> np.ndarray | None:
        """Return the `count` records of `channel`, (count, stride) uint8; None if their sequence numbers are wrong.

        These must count up from `first_sequence`. ValueError: a record has not `stride` bytes.
        """
        content, table = self._addresses
        records = np.empty((count, stride), dtype=np.uint8)
        wrong = _gather(content, table, len(self.table), channel, first_sequence, stride, records)
        if wrong == OTHER_LENGTH:
            raise ValueError("messages whose length does not match their schema")
        return None if wrong == OTHER_SEQUENCE else records


@dataclass(eq=False)
class Damage(Exception):
    """Error that bytes of a recording differ from those written: offset of the record, reason as half a sentence."""

    position: int
    reason: str


@dataclass
class Scan:
    """Sequential reader of the MCAP records of a recording's file, which checks them; `position` is their end so far.

    After `contents`, `complete` is true if the file has the ending of a finished one. `rest` are bytes at the end that
    make no complete record. `statistics` is the file's record, None if missing or not complete.
    """

    file: BinaryIO
    complete: bool = False
    rest: int = 0
    statistics: Statistics | None = None
    position: int = 0

    def contents(self) -> Iterator[tuple[int, bytes | Metadata]]:
        """Yield checked chunks' contents and metadata, with offsets, as far as complete; Damage: a check fails."""
        size = self.file.seek(0, os.SEEK_END)
        self.file.seek(max(0, size - len(MCAP0_MAGIC)))
        # in a file of 8 bytes the opening magic is no closing magic
        finished = self.file.read() == MCAP0_MAGIC and size > len(MCAP0_MAGIC)
        self.file.seek(0)
        crc = zlib.crc32(self.file.read(len(MCAP0_MAGIC)))
        position = len(MCAP0_MAGIC)
        most, metadata = unpack_allowance(size), 0
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
            if length > MAX_RECORD_BYTES:
                raise Damage(position, f"a record of {length / 1e6:.0f} MB; twin writes smaller ones only")
            body = self.file.read(length)
            if opcode == Opcode.DATA_END:
                if _parse_record(position, opcode, body) != DataEnd(crc):
                    raise Damage(position, "its CRC fails though no chunk's does, so metadata may be wrong")
                self._check_summary(end)
                return
            crc = zlib.crc32(body, zlib.crc32(prefix, crc))
            if opcode != Opcode.MESSAGE_INDEX:
                record = _parse_record(position, opcode, body)
                if isinstance(record, Chunk):
                    content = _chunk_content(position, record, most)
                    most -= len(content)
                    yield position, content
                elif isinstance(record, Metadata):
                    metadata += length
                    if metadata > MAX_TEXT_BYTES:
                        raise Damage(position, f"more than {MAX_TEXT_BYTES / 2**20:g} MB of metadata")
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


def _parse_record(position: int, opcode: int, body: bytes) -> Header | Chunk | Metadata | Attachment | DataEnd:
    """Parse an MCAP record's `body`, which the record must fill exactly."""
    if opcode not in RECORD_READERS:
        raise Damage(position, f"an unexpected record of kind {opcode}")
    try:
        record = RECORD_READERS[opcode](ReadDataStream(BytesIO(body)))
    # a damaged length inside may exceed the range of an index
    except (McapError, struct.error, ValueError, OverflowError) as error:
        raise Damage(position, "a record that does not parse") from error
    # mcap's readers return truncated data if a length inside points beyond the record
    if encode_record(record)[RECORD_PREFIX:] != body:
        raise Damage(position, "a record that does not parse")
    return record


def _chunk_content(position: int, chunk: Chunk, most: int) -> bytes:
    try:
        if chunk.compression != "zstd":
            raise ValueError("a chunk that is not compressed by zstd")
        content = decompress_chunk(chunk, most, MAX_RECORD_BYTES)
    except ValueError as problem:
        raise Damage(position, str(problem)) from problem
    if zlib.crc32(content) != chunk.uncompressed_crc:
        raise Damage(position, "a chunk that fails its CRC")
    return content


@dataclass(frozen=True)
class Event:
    """An event of a run at a simulation time, s: `debug`, `info`, `warning`, `error` or `fatal`; text and component."""

    time: float
    level: str
    text: str
    name: str


@dataclass
class TopicSeries:
    """The messages of a numeric topic, in the order of the file: `parts` of each chunk, (n, layout.stride) uint8."""

    fields: tuple[Field, ...]
    layout: MessageLayout
    parts: list[np.ndarray] = field(default_factory=list)

    def all_records(self) -> np.ndarray:
        """Concatenate all records of the topic, (n, stride) uint8, and check the bytes between the numbers."""
        records = np.concatenate([np.empty((0, self.layout.stride), np.uint8), *self.parts])
        for part in self.layout.framing:
            if np.any(records[:, part] != self.layout.filling.template[part]):
                raise ValueError("messages whose bytes do not match their schema")
        return records


@dataclass
class Contents:
    """Schemas, channels and messages of a recording's chunks read so far.

    Topics are by channel number and without the leading slash; messages of `foreign` channels, for viewers and other
    senders, are skipped. `counts` are messages so far, i.e. the next expected sequence number.
    """

    series: dict[int, TopicSeries] = field(default_factory=dict)
    topics: dict[int, str] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    foreign: set[int] = field(default_factory=set)
    counts: Counter[int] = field(default_factory=Counter)
    _schemas: dict[int, Schema] = field(default_factory=dict)
    _channels: dict[int, Channel] = field(default_factory=dict)

    def add(self, position: int, content: bytes) -> None:
        """Add all messages of a chunk, which begins at `position` in the file; add nothing if a check fails.

        Damage: earlier messages are missing. ValueError, KeyError, struct.error, McapError, DecodeError: other layout.
        """
        records = Records(content)
        is_message = records.table[:, CHANNEL_COLUMN] >= 0
        declared = self._read_declarations(position, content, records.table[~is_message])
        messages = records.table[is_message]
        of_channel = messages[:, CHANNEL_COLUMN]
        number = np.bincount(of_channel)
        counts = {channel: int(number[channel]) for channel in np.flatnonzero(number).tolist()}
        parts, logs = {}, []
        for channel, count in counts.items():
            place = messages[(of_channel == channel).argmax(), PLACE_COLUMN] if channel in declared else 0
            if channel not in self._channels or place < declared.get(channel, 0):
                raise Damage(position, "a chunk before which the declaration of its topics is missing")
            if channel in self.series:
                part = records.channel_records(channel, count, self.counts[channel], self.series[channel].layout.stride)
                if part is None:
                    raise Damage(position, MISSING_MESSAGES)
                parts[channel] = part
                continue
            sequence = messages[of_channel == channel, SEQUENCE_COLUMN]
            if not np.array_equal(sequence, np.arange(count) + self.counts[channel]):
                raise Damage(position, MISSING_MESSAGES)
            if channel not in self.foreign:
                logs.append(channel)
        logged = messages[np.isin(of_channel, logs)] if logs else ()
        events = [_event(_body(content, record)) for record in logged]
        for channel, part in parts.items():
            self.series[channel].parts.append(part)
        self.events += events
        self.counts.update(counts)

    def _read_declarations(self, position: int, content: bytes, others: np.ndarray) -> dict[int, int]:
        """Register the schemas and channels among the records `others`; return channel number -> its offset."""
        declared: dict[int, int] = {}
        for record in others:
            place, opcode, length = record[: LENGTH_COLUMN + 1].tolist()
            if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
                raise Damage(position, f"a chunk with a record of kind {opcode} and {length} bytes")
            stream = ReadDataStream(BytesIO(_body(content, record)))
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self._schemas[schema.id] = schema
                continue
            channel = Channel.read(stream)
            if self._channels.setdefault(channel.id, channel) is channel:
                declared[channel.id] = place
                self._declare(channel, self._schemas[channel.schema_id])
            elif self._channels[channel.id] != channel:
                raise ValueError(f"two topics share the channel {channel.id}")
        return declared

    def _declare(self, channel: Channel, schema: Schema) -> None:
        if schema.name == Log.DESCRIPTOR.full_name:
            return
        # a robot's own messages are recorded unchanged alongside the twin's
        if schema.name.startswith(FOREIGN_PREFIX) or channel.message_encoding != "protobuf":
            self.foreign.add(channel.id)
            return
        fields = descriptor_fields(schema.name, schema.data)
        topic = channel.topic.removeprefix("/")
        check_stream(topic, 1)
        if topic in self.topics.values():
            raise ValueError(f"two channels of the topic {topic}")
        self.series[channel.id] = TopicSeries(fields, message_layout(channel.id, fields))
        self.topics[channel.id] = topic


def _body(content: bytes, record: np.ndarray) -> bytes:
    place, _, length = record[: LENGTH_COLUMN + 1].tolist()
    return content[place + RECORD_PREFIX : place + RECORD_PREFIX + length]


def _event(body: bytes) -> Event:
    message = Message.read(ReadDataStream(BytesIO(body)), len(body))
    log = Log.FromString(message.data)
    return Event(message.log_time / NS_PER_S, Log.Level.Name(log.level).lower(), log.message, log.name)
