"""MCAP files that others wrote: checked by their CRCs, read as far as they go (https://mcap.dev/spec)."""

import struct
import zlib
from collections.abc import Iterator, Mapping
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Header, McapRecord, Message, Schema, Statistics
from mcap.stream_reader import StreamReader
from mcap.writer import MCAP0_MAGIC

from twin.recording.chunks import allowance, unpacked
from twin.recording.logs.column_map import MappedColumn
from twin.recording.logs.errors import LogRefused
from twin.recording.logs.log import Log
from twin.recording.logs.topic import LoggedTopic
from twin.recording.logs.topics import NANOSECONDS, log_of, merged, wanted
from twin.recording.messages import RECORD_PREFIX

MAGIC = MCAP0_MAGIC
_PREFIX, _MESSAGE = struct.Struct("<BQ"), struct.Struct("<HIQQ")
"""What every record begins with, and a message behind that: https://mcap.dev/spec#message-op0x05."""
LONGEST_RECORD, LONGEST_HEADER = 2**30, 2**20
"""Bytes; a damaged length must not ask for any amount of memory."""


def written_by_twin(path: Path) -> bool:
    """Whether the header of an MCAP file says that `twin.recording` wrote it; a damaged header does not."""
    with path.open("rb") as file:
        try:
            header = next(StreamReader(file, record_size_limit=LONGEST_HEADER).records)
        except (McapError, ValueError, struct.error, StopIteration, OverflowError, MemoryError):
            return False
    return isinstance(header, Header) and header.library.startswith("twin ")


def read_mcap(path: Path, columns: Mapping[str, MappedColumn]) -> Log:
    """The log in the MCAP file `path`; one that ends early is read up to there, and a note says so.

    Args:
        columns: see `log_of`.

    Raises:
        LogRefused: damaged, or as `log_of`.
    """
    found, note = topics_in(path, columns)
    return log_of(path, merged(found), columns, (note,) if note else ())


def topics_in(path: Path, columns: Mapping[str, MappedColumn]) -> tuple[list[LoggedTopic], str]:
    """Topics of the file `path`, one for each publisher, and a sentence on what is missing at the end.

    Args:
        columns: of which topics the messages are kept.

    Raises:
        LogRefused: damaged.
    """
    schemas: dict[int, Schema] = {}
    channels: dict[int, LoggedTopic] = {}
    kept: set[int] = set()
    with path.open("rb") as file:
        file.seek(-len(MAGIC), 2)
        finished = file.read() == MAGIC and file.tell() > len(MAGIC)
        file.seek(0)
        reader = StreamReader(file, emit_chunks=True, validate_crcs=True, record_size_limit=LONGEST_RECORD)
        note, expected = "", None
        try:
            for record in _records(reader, allowance(path.stat().st_size)):
                if isinstance(record, Schema):
                    schemas[record.id] = record
                elif isinstance(record, Channel):
                    channels.setdefault(record.id, LoggedTopic(record, schemas.get(record.schema_id)))
                    if wanted(record.topic, columns):
                        kept.add(record.id)
                elif isinstance(record, Message):
                    channels[record.channel_id].times.append(record.log_time)
                    if record.channel_id in kept:
                        channels[record.channel_id].data.append(record.data)
                elif isinstance(record, Statistics):
                    expected = record.message_count
        except (McapError, ValueError, LookupError, OverflowError, struct.error, MemoryError) as problem:
            if finished or not isinstance(problem, EndOfFile | struct.error):
                raise LogRefused(
                    f"{path}: damaged near byte {file.tell()}: {problem or 'a record is cut short'}; "
                    "recover what is readable first (mcap recover)"
                ) from None
            note = "the file ends early"
    topics = list(channels.values())
    count = sum(len(topic.times) for topic in topics)
    # few writers fill in the CRC of the whole, and a record whose kind is damaged is skipped
    if expected not in (None, count):
        raise LogRefused(f"{path}: damaged: {count} messages where its index says {expected}; mcap recover may help")
    last = max((max(t.times) for t in topics if t.times), default=0)
    first = min((min(t.times) for t in topics if t.times), default=0)
    return topics, f"{note}: read {(last - first) / NANOSECONDS:.3f} s of it" if note else ""


def _records(reader: StreamReader, most: int) -> Iterator[McapRecord]:
    """Records of a file, those in its chunks among them, which may unpack to `most` bytes in all."""
    for record in reader.records:
        if isinstance(record, Chunk):
            content = unpacked(record, most)
            most -= len(content)
            if record.uncompressed_crc not in (0, found := zlib.crc32(content)):
                raise ValueError(f"a chunk has the CRC {found:08x}, expected {record.uncompressed_crc:08x}")
            yield from _inside(content)
        else:
            yield record


def _inside(content: bytes) -> Iterator[McapRecord]:
    """The records in a chunk, one by one: mcap's own way has all of them in memory, ten times what they unpack to."""
    place = 0
    while place < len(content):
        if place + RECORD_PREFIX > len(content):
            raise EndOfFile
        opcode, length = _PREFIX.unpack_from(content, place)
        begin, place = place + RECORD_PREFIX, place + RECORD_PREFIX + length
        if place > len(content):
            raise EndOfFile
        if opcode == Opcode.MESSAGE:
            if length < _MESSAGE.size:
                raise ValueError("a message is cut short")
            channel, sequence, logged, published = _MESSAGE.unpack_from(content, begin)
            data = content[begin + _MESSAGE.size : place]
            yield Message(channel_id=channel, sequence=sequence, log_time=logged, publish_time=published, data=data)
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            kind = Schema if opcode == Opcode.SCHEMA else Channel
            yield kind.read(ReadDataStream(BytesIO(content[begin:place])))
