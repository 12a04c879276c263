"""Recordings taken apart, changed, and sealed again: every CRC, size and index right, whatever is inside."""

import contextlib
import struct
import zlib
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata
from mcap.writer import MCAP0_MAGIC

from twin.kernel.recording.summary import encode_record

FRONT = struct.Struct("<BQ")
Record = tuple[int, bytes]


def records(content: bytes) -> list[Record]:
    """(kind, body) of the records in `content`, which begins with one."""
    found, place = [], 0
    while place + FRONT.size <= len(content):
        kind, length = FRONT.unpack_from(content, place)
        place += FRONT.size + length
        found.append((kind, content[place - length : place]))
    return found


def joined(parts: Iterable[Record]) -> bytes:
    """The records one after another."""
    return b"".join(FRONT.pack(kind, len(body)) + body for kind, body in parts)


def data_records(path: Path) -> list[Record]:
    """Everything before the end of the data of a finished recording."""
    found = records(path.read_bytes()[len(MCAP0_MAGIC) : -len(MCAP0_MAGIC)])
    return found[: next(k for k, (kind, _) in enumerate(found) if kind == Opcode.DATA_END)]


def sealed(data: Iterable[Record], path: Path, counted: dict[int, int] | None = None) -> Path:
    """Write a finished file of these records to `path`: its CRCs right, its statistics those of what is in it.

    Args:
        data: up to the end of the data. path: of the file. counted: messages by channel that it claims to hold.
    """
    data = list(data)
    front = MCAP0_MAGIC + joined(data)
    body = joined([(Opcode.DATA_END, struct.pack("<I", zlib.crc32(front)))])
    counts = counted if counted is not None else message_counts(data)
    entries = b"".join(struct.pack("<HQ", *item) for item in sorted(counts.items()))
    chunks = sum(kind == Opcode.CHUNK for kind, _ in data)
    statistics = struct.pack("<QHIIIIQQI", sum(counts.values()), 0, 0, 0, 0, chunks, 0, 0, len(entries)) + entries
    summary = joined([(Opcode.STATISTICS, statistics)])
    footer = FRONT.pack(Opcode.FOOTER, 20) + struct.pack("<QQ", len(front) + len(body), 0)
    crc = struct.pack("<I", zlib.crc32(summary + footer))
    path.write_bytes(front + body + summary + footer + crc + MCAP0_MAGIC)
    return path


def message_counts(data: Iterable[Record]) -> dict[int, int]:
    """Messages by channel in the chunks of `data` that can be read."""
    counts: dict[int, int] = {}
    for kind, body in data:
        if kind != Opcode.CHUNK:
            continue
        with contextlib.suppress(struct.error, UnicodeDecodeError, McapError, zstandard.ZstdError):
            for inner, message in records(content_of(body)):
                if inner == Opcode.MESSAGE and len(message) >= 2:
                    channel = int.from_bytes(message[:2], "little")
                    counts[channel] = counts.get(channel, 0) + 1
    return counts


def content_of(chunk: bytes) -> bytes:
    """What is in a chunk's record, decompressed."""
    return zstandard.decompress(_chunk(chunk).data)


def with_content(chunk: bytes, content: bytes) -> bytes:
    """A chunk's record with other content, and sizes and CRC to match."""
    old = _chunk(chunk)
    data = zstandard.ZstdCompressor(level=1).compress(content)
    new = replace(old, data=data, uncompressed_size=len(content), uncompressed_crc=zlib.crc32(content))
    return encode_record(new)[FRONT.size :]


def without_last(data: list[Record], topic: str) -> list[Record]:
    """`data` without the last message of `topic`."""
    chunks = {place: records(content_of(body)) for place, (kind, body) in enumerate(data) if kind == Opcode.CHUNK}
    channels = (
        Channel.read(_stream(body)) for inner in chunks.values() for kind, body in inner if kind == Opcode.CHANNEL
    )
    wanted = next(channel.id for channel in channels if channel.topic == topic)
    place, last = max(
        (place, n)
        for place, inner in chunks.items()
        for n, (kind, body) in enumerate(inner)
        if kind == Opcode.MESSAGE and int.from_bytes(body[:2], "little") == wanted
    )
    del chunks[place][last]
    changed = with_content(data[place][1], joined(chunks[place]))
    return [*data[:place], (Opcode.CHUNK, changed), *data[place + 1 :]]


def with_metadata(data: list[Record], change: Callable[[str, dict[str, str]], dict[str, str] | None]) -> list[Record]:
    """`data` with each metadata record as `change`(name, entries) gives it; None takes it out."""
    changed: list[Record] = []
    for kind, body in data:
        if kind != Opcode.METADATA:
            changed.append((kind, body))
            continue
        record = Metadata.read(_stream(body))
        entries = change(record.name, dict(record.metadata))
        if entries is not None:
            changed.append((kind, encode_record(Metadata(record.name, entries))[FRONT.size :]))
    return changed


def _chunk(body: bytes) -> Chunk:
    return Chunk.read(_stream(body))


def _stream(body: bytes) -> ReadDataStream:
    from io import BytesIO

    return ReadDataStream(BytesIO(body))
