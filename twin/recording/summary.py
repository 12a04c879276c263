"""The end of an MCAP file: everything a reader needs to jump into it (https://mcap.dev/spec#summary-section)."""

import struct
import zlib
from collections import Counter
from dataclasses import dataclass, field

from mcap.opcode import Opcode
from mcap.records import (
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

from twin.recording.chunks import encoded

FOOTER_LENGTH = 8 + 8 + 4


@dataclass
class Summary:
    """What has been written so far, in the records that will end the file.

    Attributes:
        schemas: as written in the first chunk.
        channels: likewise.
        chunks: index record of each chunk.
        metadata: index record of each metadata record.
        message_counts: messages by channel number.
    """

    schemas: list[Schema]
    channels: list[Channel]
    chunks: list[ChunkIndex] = field(default_factory=list)
    metadata: list[MetadataIndex] = field(default_factory=list)
    message_counts: Counter[int] = field(default_factory=Counter)

    def note_chunk(self, chunk: Chunk, start: int, length: int, indexes: dict[int, bytes]) -> None:
        """Index a chunk written at byte `start` with `length`, its message indexes right after it."""
        offsets = {}
        end = start + length
        for channel, index in indexes.items():
            offsets[channel] = end
            end += len(index)
        self.chunks.append(
            ChunkIndex(
                chunk_length=length,
                chunk_start_offset=start,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=chunk.message_end_time,
                message_index_length=end - start - length,
                message_index_offsets=offsets,
                message_start_time=chunk.message_start_time,
                uncompressed_size=chunk.uncompressed_size,
            )
        )

    def statistics(self) -> Statistics:
        """Counts and time span (ns) of everything written."""
        return Statistics(
            attachment_count=0,
            channel_count=len(self.channels),
            channel_message_counts=dict(sorted(self.message_counts.items())),
            chunk_count=len(self.chunks),
            message_count=sum(self.message_counts.values()),
            message_end_time=max((c.message_end_time for c in self.chunks), default=0),
            message_start_time=min((c.message_start_time for c in self.chunks), default=0),
            metadata_count=len(self.metadata),
            schema_count=len(self.schemas),
        )

    def ending(self, data_size: int, data_crc: int) -> bytes:
        """DataEnd, summary section, footer and magic after `data_size` bytes with CRC-32 `data_crc`."""
        data_end = encoded(DataEnd(data_crc))
        start = data_size + len(data_end)
        groups: list[tuple[Opcode, list]] = [
            (Opcode.SCHEMA, self.schemas),
            (Opcode.CHANNEL, self.channels),
            (Opcode.STATISTICS, [self.statistics()]),
            (Opcode.CHUNK_INDEX, self.chunks),
            (Opcode.METADATA_INDEX, self.metadata),
        ]
        body = b""
        offsets: list[McapRecord] = []
        for opcode, records in groups:
            group = b"".join(map(encoded, records))
            if group:
                offsets.append(SummaryOffset(opcode, start + len(body), len(group)))
            body += group
        offset_start = start + len(body)
        body += b"".join(map(encoded, offsets))
        # the CRC also covers the footer up to the CRC itself
        front = struct.pack("<BQQQ", Opcode.FOOTER, FOOTER_LENGTH, start, offset_start)
        footer = Footer(start, offset_start, zlib.crc32(body + front))
        return data_end + body + encoded(footer) + MCAP0_MAGIC
