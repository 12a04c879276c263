"""Digests of what a recording holds, topic by topic, read by what MCAP says and by nothing of the twin's own.

Layout: https://mcap.dev/spec
"""

import hashlib
import json
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import zstandard
from numpy.typing import NDArray

MAGIC = b"\x89MCAP0\r\n"
SCHEMA, CHANNEL, CHUNK, INDEX, STATISTICS, METADATA = 3, 4, 6, 7, 11, 12
HEADER = 9
"""Bytes before a record's content: what it is, and its length."""
BEFORE_TIME = HEADER + 6
"""Bytes of a message before its log time: channel and number, which may change without anything that is recorded."""
SECOND = 1_000_000_000
SHORT = 8
"""Digits that tell two seconds of a topic apart."""


def digests(path: Path) -> dict[str, Any]:
    """What is recorded at `path`.

    Returns:
        each topic's name with its number of messages, the digest of their times and data, and a short digest of each
        second, by which it is known where two recordings part; "TOPIC layout" with its channel and schema; and
        "metadata NAME" with the text of each metadata record.

    Raises:
        ValueError: the file is no recording, or its message indexes do not name every message.
    """
    content = path.read_bytes()
    if not content.startswith(MAGIC):
        raise ValueError(f"{path}: no MCAP file")
    schemas: dict[int, tuple[str, str, str]] = {}
    channels: dict[int, tuple[int, str, str, dict[str, str]]] = {}
    metadata: dict[str, str] = {}
    stated: dict[int, int] = {}
    chunks: list[bytes] = []
    places: dict[int, list[NDArray[np.uint64]]] = {}
    begin = end = 0
    for kind, at, length in _records(content, len(MAGIC), len(content) - len(MAGIC)):
        if kind == CHUNK:
            chunks.append(_unpacked(content, at, length))
            begin, end = end, end + len(chunks[-1])
        elif kind == INDEX:
            channel, size = struct.unpack_from("<HI", content, at)
            entries = np.frombuffer(content, "<u8", size // 8, at + 6).reshape(-1, 2)
            places.setdefault(channel, []).append(entries[:, 1] + np.uint64(begin))
        elif kind == SCHEMA:
            number, name, encoding, data = _schema(content, at)
            schemas[number] = name, encoding, hashlib.sha256(data).hexdigest()
        elif kind == CHANNEL:
            number, schema = struct.unpack_from("<HH", content, at)
            topic, after = _text(content, at + 4)
            encoding, after = _text(content, after)
            channels[number] = schema, topic, encoding, _texts(content, after)
        elif kind == METADATA:
            name, after = _text(content, at)
            metadata[f"metadata {name}"] = json.dumps(_texts(content, after), indent=0, sort_keys=True)
        elif kind == STATISTICS:
            (size,) = struct.unpack_from("<I", content, at + 42)
            stated = dict(struct.iter_unpack("<HQ", content[at + 46 : at + 46 + size]))
    found: dict[str, Any] = {}
    messages = np.frombuffer(b"".join(chunks), np.uint8)
    for number, (schema, topic, encoding, fields) in channels.items():
        offsets = np.concatenate(places.get(number, [np.zeros(0, np.uint64)])).astype(np.int64)
        if len(offsets) != stated.get(number, 0):
            raise ValueError(f"{path}: {topic}: {len(offsets)} messages in the indexes, {stated.get(number, 0)} stated")
        found[topic] = _digest(messages, offsets)
        found[f"{topic} layout"] = json.dumps([encoding, *schemas[schema], fields], indent=0, sort_keys=True)
    return found | metadata


def _records(content: bytes, start: int, end: int) -> Iterator[tuple[int, int, int]]:
    """Kind, start and length of each record's content."""
    while start < end:
        kind, length = struct.unpack_from("<BQ", content, start)
        yield kind, start + HEADER, length
        start += HEADER + length


def _unpacked(content: bytes, at: int, length: int) -> bytes:
    (size,) = struct.unpack_from("<Q", content, at + 16)
    compression, after = _text(content, at + 28)
    packed = content[after + 8 : at + length]
    if compression not in ("", "zstd"):
        raise ValueError(f"chunks packed by {compression}: only zstd is known here")
    return zstandard.decompress(packed, max_output_size=size) if compression else packed


def _schema(content: bytes, at: int) -> tuple[int, str, str, bytes]:
    (number,) = struct.unpack_from("<H", content, at)
    name, after = _text(content, at + 2)
    encoding, after = _text(content, after)
    (size,) = struct.unpack_from("<I", content, after)
    return number, name, encoding, content[after + 4 : after + 4 + size]


def _text(content: bytes, at: int) -> tuple[str, int]:
    """A text, and where what follows it begins."""
    (size,) = struct.unpack_from("<I", content, at)
    return content[at + 4 : at + 4 + size].decode(), at + 4 + size


def _texts(content: bytes, at: int) -> dict[str, str]:
    """A table of texts."""
    (size,) = struct.unpack_from("<I", content, at)
    end, at, found = at + 4 + size, at + 4, {}
    while at < end:
        key, at = _text(content, at)
        found[key], at = _text(content, at)
    return found


def _digest(messages: NDArray[np.uint8], offsets: NDArray[np.int64]) -> dict[str, Any]:
    """Number, digest and digests of seconds of the messages that begin at `offsets`; of their times and data only."""
    if not len(offsets):
        return {"messages": 0, "digest": "", "seconds": ""}
    lengths = _numbers(messages, offsets + 1) + HEADER
    seconds = _numbers(messages, offsets + BEFORE_TIME) // SECOND
    if (lengths == lengths[0]).all():
        # all at once: a row each
        width = int(lengths[0]) - BEFORE_TIME
        rows = np.lib.stride_tricks.sliding_window_view(messages, width)[offsets + BEFORE_TIME]
        bounds = np.flatnonzero(np.diff(seconds)) + 1
        parts: list[Any] = [b"%d " % width, *np.split(rows, bounds)]
    else:
        texts = [
            b"%d " % (length - BEFORE_TIME) + messages[at + BEFORE_TIME : at + length].tobytes()
            for at, length in zip(offsets.tolist(), lengths.tolist(), strict=True)
        ]
        parts = [b""] + [
            b"".join(texts[part[0] : part[-1] + 1])
            for part in np.split(np.arange(len(texts)), np.flatnonzero(np.diff(seconds)) + 1)
        ]
    each = [hashlib.sha256(part).hexdigest() for part in parts]
    whole = hashlib.sha256("".join(each).encode()).hexdigest()
    return {"messages": len(offsets), "digest": whole, "seconds": "".join(part[:SHORT] for part in each[1:])}


def _numbers(messages: NDArray[np.uint8], places: NDArray[np.int64]) -> NDArray[np.int64]:
    """The eight-byte numbers that begin at `places`."""
    windows = np.lib.stride_tricks.sliding_window_view(messages, 8)
    return np.ascontiguousarray(windows[places]).view("<i8").ravel()
