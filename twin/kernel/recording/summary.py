"""Summary section and chunks of an MCAP file.

The summary section (https://mcap.dev/spec#summary-section) is the index for readers. Chunks, compressed and
decompressed: https://mcap.dev/spec#chunk-op0x06.
"""

import struct
import zlib
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from itertools import accumulate

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    McapRecord,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

MIN_UNPACK_ALLOWANCE = 64 * 2**20
MAX_UNPACK_RATIO = 100
"""Limits of the decompressed size of all chunks: minimum for any file (bytes), and maximum ratio to the file's size. A
recording in which nothing ever changes has a ratio of 20; a decompression bomb has thousands."""
MAX_CHUNK_BYTES = 256 * 2**20
"""Maximum decompressed size of one chunk (bytes), however large the file: all of it is in memory at once."""
# doubles hardly compress: levels 3 and 5 save 1 % and 4 % of the file and cost 20 % and 90 % more time in all
COMPRESSION_LEVEL = 1
FOOTER_LENGTH = 8 + 8 + 4
_Layout = tuple[tuple[int, int], ...]
"""(channel, length of its index) of each channel of a chunk, in order."""


def make_chunk(content: memoryview | bytes, start: int, end: int, compressor: zstandard.ZstdCompressor) -> Chunk:
    """Compress records, with messages from `start` to `end` (ns), into an MCAP chunk record."""
    return Chunk(
        compression="zstd",
        data=compressor.compress(content),
        message_start_time=start,
        message_end_time=end,
        uncompressed_crc=zlib.crc32(content),
        uncompressed_size=len(content),
    )


def unpack_allowance(size: int) -> int:
    """Return the maximum decompressed size (bytes) of all chunks of an MCAP file of `size` bytes."""
    return max(MIN_UNPACK_ALLOWANCE, MAX_UNPACK_RATIO * size)


def decompress_chunk(chunk: Chunk, most: int, largest: int = MAX_CHUNK_BYTES) -> bytes:
    """Decompress an MCAP chunk of any writer (zstd, LZ4, uncompressed), at most `most` and `largest` bytes.

    `most` is the remaining allowance of the file, `largest` the limit of one chunk. ValueError: the declared size
    exceeds a limit or differs from the decompressed size (no more than the declared size is ever in memory), the data
    does not decompress, or the compression is unsupported.
    """
    size = chunk.uncompressed_size
    if size > most:
        raise ValueError(
            f"a chunk that would unpack to {size / 1e6:.0f} MB, more than {MAX_UNPACK_RATIO} times the file"
        )
    if size > largest:
        raise ValueError(
            f"a chunk that would unpack to {size / 1e6:.0f} MB; expected chunks of at most {largest / 1e6:.0f} MB"
        )
    try:
        match chunk.compression:
            case "zstd":
                # -1: the frame does not state its size; max_output_size then limits it
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


def encode_record(record: McapRecord) -> bytes:
    """Encode an MCAP record with its opcode and length."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()


@dataclass
class Summary:
    """Records of an MCAP file's summary section (indexes and statistics) for everything written so far.

    Schemas and channels are written in the first chunk; messages are counted by channel number.
    """

    schemas: list[Schema]
    channels: list[Channel]
    chunks: list[ChunkIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    attachments: list[AttachmentIndex] = field(default_factory=list)
    message_counts: Counter[int] = field(default_factory=Counter)

    def __post_init__(self) -> None:
        self._layouts: dict[_Layout, _Layout] = {}
        self._of_chunks: list[_Layout] = []
        """Index layout of each chunk; equal ones are shared, since separate ones would grow with the recording."""

    def note_chunk(self, chunk: Chunk, start: int, length: int, indexes: dict[int, bytes]) -> None:
        """Index an MCAP chunk written at byte `start` with `length`; its message indexes follow directly."""
        layout = tuple((channel, len(index)) for channel, index in indexes.items())
        self._of_chunks.append(self._layouts.setdefault(layout, layout))
        self.chunks.append(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=start,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=sum(size for _, size in layout),
                message_index_offsets={},
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )

    def statistics(self) -> Statistics:
        """Return the MCAP statistics record: counts and time span (ns) of everything written."""
        return Statistics(
            attachment_count=len(self.attachments),
            channel_count=len(self.channels),
            channel_message_counts=dict(sorted(self.message_counts.items())),
            chunk_count=len(self.chunks),
            message_count=sum(self.message_counts.values()),
            message_end_time=max((c.message_end_time for c in self.chunks), default=0),
            message_start_time=min((c.message_start_time for c in self.chunks), default=0),
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )

    def ending(self, data_size: int, data_crc: int) -> Iterator[bytes]:
        """Yield DataEnd, summary, footer and magic of an MCAP file of `data_size` bytes with the CRC-32 `data_crc`."""
        data_end = encode_record(DataEnd(data_crc))
        yield data_end
        start = place = data_size + len(data_end)
        groups: list[tuple[Opcode, Iterable[McapRecord]]] = [
            (Opcode.SCHEMA, self.schemas),
            (Opcode.CHANNEL, self.channels),
            (Opcode.STATISTICS, [self.statistics()]),
            (Opcode.CHUNK_INDEX, map(_locate_indexes, self.chunks, self._of_chunks)),
            (Opcode.ATTACHMENT_INDEX, self.attachments),
            (Opcode.METADATA_INDEX, self.metadata),
        ]
        crc = 0
        offsets: list[McapRecord] = []
        for opcode, records in groups:
            begin = place
            for data in map(encode_record, records):
                crc = zlib.crc32(data, crc)
                place += len(data)
                yield data
            if place > begin:
                offsets.append(SummaryOffset(opcode, begin, place - begin))
        ends = b"".join(map(encode_record, offsets))
        # the CRC also covers the footer up to the CRC itself
        front = struct.pack("<BQQQ", Opcode.FOOTER, FOOTER_LENGTH, start, place)
        footer = Footer(start, place, zlib.crc32(ends + front, crc))
        yield ends + encode_record(footer) + MCAP0_MAGIC


def _locate_indexes(chunk: ChunkIndex, layout: _Layout) -> ChunkIndex:
    """Return the index record of a chunk, completed by the file offsets of its message indexes."""
    ends = accumulate((size for _, size in layout), initial=chunk.chunk_start_offset + chunk.chunk_length)
    return replace(chunk, message_index_offsets={channel: end for (channel, _), end in zip(layout, ends, strict=False)})
