"""Chunks, compressed and unpacked: https://mcap.dev/spec#chunk-op0x06."""

import zlib

import lz4.frame
import zstandard
from mcap.data_stream import RecordBuilder
from mcap.records import Chunk, McapRecord

FEW_BYTES = 64 * 2**20
LARGEST_RATIO = 100
"""Bytes that chunks may unpack to: those of a file, however small, and how many times its own. A recording in which
nothing ever changes has a ratio of 20; a bomb has thousands."""
LARGEST_CHUNK = 256 * 2**20
"""Bytes that one chunk may unpack to, however large the file: all of it is in memory at once."""
# doubles hardly compress: levels 3 and 5 save 1 % and 4 % of the file and cost 20 % and 90 % more time in all
COMPRESSION_LEVEL = 1


def chunk(content: memoryview | bytes, start: int, end: int, compressor: zstandard.ZstdCompressor) -> Chunk:
    """Chunk record of `content`, whose messages have log times from `start` to `end`, ns."""
    return Chunk(
        compression="zstd",
        data=compressor.compress(content),
        message_start_time=start,
        message_end_time=end,
        uncompressed_crc=zlib.crc32(content),
        uncompressed_size=len(content),
    )


def allowance(size: int) -> int:
    """Bytes that all chunks of a file of `size` bytes may unpack to."""
    return max(FEW_BYTES, LARGEST_RATIO * size)


def unpacked(chunk: Chunk, most: int, largest: int = LARGEST_CHUNK) -> bytes:
    """Content of `chunk`, of any writer: at most `most` bytes, compressed by zstd, LZ4 or not at all.

    Args:
        most: what is left of the file's allowance.
        largest: bytes of any one chunk.

    Raises:
        ValueError: it declares more than these, or unpacks to another size than it declares, of which no more than
            that is ever in memory; it does not unpack, or is compressed in another way.
    """
    size = chunk.uncompressed_size
    if size > most:
        raise ValueError(f"a chunk that would unpack to {size / 1e6:.0f} MB, more than {LARGEST_RATIO} times the file")
    if size > largest:
        raise ValueError(
            f"a chunk that would unpack to {size / 1e6:.0f} MB; expected chunks of at most {largest / 1e6:.0f} MB"
        )
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


def encoded(record: McapRecord) -> bytes:
    """Bytes of an MCAP record with its opcode and length."""
    builder = RecordBuilder()
    record.write(builder)
    return builder.end()
