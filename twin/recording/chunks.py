"""Blocks of messages woven into chunks: in order of time across topics, compressed, indexed.

Layout of the records: https://mcap.dev/spec#chunk-op0x06 and #message-index-op0x07.
"""

import struct
import zlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import lz4.frame
import numpy as np
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import Chunk, McapRecord

# small enough that little is lost with the last one, large enough to compress; before compression, bytes
LARGEST_CHUNK = 256 * 1024
FEW_BYTES = 64 * 2**20
LARGEST_RATIO = 100
"""Bytes that chunks may unpack to: those of a file, however small, and how many times its own. A recording in which
nothing ever changes has a ratio of 20; a bomb has thousands."""
# doubles hardly compress: levels 3 and 5 save 1 % and 4 % of the file and cost 20 % and 90 % more time in all
COMPRESSION_LEVEL = 1


@dataclass(frozen=True)
class RecordBlock:
    """Message records of one channel.

    Attributes:
        channel: its number.
        times: log times, ns, (n,) int64, ascending.
        records: (n, stride) uint8.
    """

    channel: int
    times: np.ndarray
    records: np.ndarray


@dataclass(frozen=True)
class Messages:
    """Message records of several channels in order of time.

    Attributes:
        content: the records one after another, (bytes,) uint8.
        times: log times, ns, (n,) int64, ascending.
        channels: channel numbers, (n,) int64.
        offsets: where each record starts in content, (n + 1,) int64; the last is the end of content.
    """

    content: np.ndarray
    times: np.ndarray
    channels: np.ndarray
    offsets: np.ndarray


def merged(blocks: Sequence[RecordBlock]) -> Messages:
    """The records of `blocks` in order of time; those of one time stay in the order of the blocks."""
    times = np.concatenate([block.times for block in blocks])
    counts = [len(block.times) for block in blocks]
    lengths = np.repeat([block.records.shape[1] for block in blocks], counts)
    order = np.argsort(times, kind="stable")
    offsets = np.concatenate([[0], np.cumsum(lengths[order])])
    destinations = np.empty(len(times), dtype=np.int64)
    destinations[order] = offsets[:-1]
    content = np.empty(offsets[-1], dtype=np.uint8)
    for block, ends in zip(blocks, np.cumsum(counts), strict=True):
        windows = record_windows(content, block.records.shape[1])
        # as one opaque item each, numpy moves whole records
        items = block.records.view(windows.dtype)[:, 0]
        windows[destinations[ends - len(items) : ends]] = items
    channels = np.repeat([block.channel for block in blocks], counts)
    return Messages(content, times[order], channels[order], offsets)


def record_windows(content: np.ndarray, stride: int) -> np.ndarray:
    """View of content (bytes,) uint8 as an item of `stride` bytes from every byte on, (bytes - stride + 1,).

    Indexing it with offsets gathers or scatters records of one length from among records of other lengths.
    """
    return np.ndarray((max(0, len(content) - stride + 1),), f"V{stride}", content, strides=(1,))


def pieces(messages: Messages) -> Iterator[Messages]:
    """`messages` in parts of about LARGEST_CHUNK bytes at most.

    Cuts are between ticks: whatever chunks survive, every topic ends at the same tick.
    """
    parts = -(-len(messages.content) // LARGEST_CHUNK)
    targets = np.arange(1, parts) * len(messages.content) // parts
    inside = np.searchsorted(messages.offsets, targets, side="right") - 1
    cuts = np.searchsorted(messages.times, messages.times[inside])
    bounds = np.unique([0, *cuts, len(messages.times)])
    for start, end in pairwise(bounds.tolist()):
        offsets = messages.offsets[start : end + 1]
        content = messages.content[offsets[0] : offsets[-1]]
        yield Messages(content, messages.times[start:end], messages.channels[start:end], offsets - offsets[0])


def chunk(messages: Messages, preamble: bytes, compressor: zstandard.ZstdCompressor) -> Chunk:
    """Chunk record of `preamble` (schema and channel records, or nothing) and `messages` after it."""
    content = preamble + messages.content.tobytes()
    return Chunk(
        compression="zstd",
        data=compressor.compress(content),
        message_start_time=int(messages.times[0]),
        message_end_time=int(messages.times[-1]),
        uncompressed_crc=zlib.crc32(content),
        uncompressed_size=len(content),
    )


def allowance(size: int) -> int:
    """Bytes that all chunks of a file of `size` bytes may unpack to."""
    return max(FEW_BYTES, LARGEST_RATIO * size)


def unpacked(chunk: Chunk, most: int) -> bytes:
    """Content of `chunk`, of any writer: at most `most` bytes, compressed by zstd, LZ4 or not at all.

    Raises:
        ValueError: it declares more than that, or unpacks to another size than it declares, of which no more than
            that is ever in memory; it does not unpack, or is compressed in another way.
    """
    size = chunk.uncompressed_size
    if size > most:
        raise ValueError(f"a chunk that would unpack to {size / 1e6:.0f} MB, more than {LARGEST_RATIO} times the file")
    try:
        match chunk.compression:
            case "zstd":
                # one that does not say its size unpacks to what it declares at most
                if zstandard.frame_content_size(chunk.data) not in (size, -1):
                    raise ValueError("a chunk whose sizes disagree")
                content = zstandard.decompress(chunk.data, max_output_size=size)
            case "lz4":
                content = lz4.frame.LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
            case "":
                content = chunk.data
            case other:
                raise ValueError(f"a chunk compressed by {other}; zstd and lz4 are read")
    except (zstandard.ZstdError, RuntimeError, EOFError, MemoryError):
        raise ValueError("a chunk that does not decompress") from None
    if len(content) != size:
        raise ValueError("a chunk whose sizes disagree")
    return content


def message_indexes(messages: Messages, shift: int) -> dict[int, bytes]:
    """Encoded MessageIndex records by channel; the messages start `shift` bytes into their chunk.

    Built from arrays: mcap's own MessageIndex packs entry by entry, which would cost more than all else here.
    """
    entries = np.stack([messages.times, messages.offsets[:-1] + shift], axis=1).astype("<u8")
    indexes = {}
    for channel in np.unique(messages.channels).tolist():
        own = entries[messages.channels == channel].tobytes()
        indexes[channel] = struct.pack("<BQHI", Opcode.MESSAGE_INDEX, 6 + len(own), channel, len(own)) + own
    return indexes


def encoded(record: McapRecord) -> bytes:
    """Bytes of an MCAP record with its opcode and length."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
