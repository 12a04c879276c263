"""What a recording says of its origin, read without its samples."""

import os
import struct
from io import BytesIO
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Metadata
from mcap.writer import MCAP0_MAGIC

from twin.errors import disk_refusals
from twin.files import LIMIT
from twin.recording.errors import RecordingRefused
from twin.recording.messages import RECORD_PREFIX


def origin(path: Path) -> dict[str, dict[str, str]]:
    """The metadata of the recording's file `path`, finished or not: name -> key -> text.

    Goes from record to record; samples are passed over. Nothing is checked: `reader.read` does that.

    Raises:
        RecordingRefused: it cannot be read, or is no MCAP file.
    """
    found: dict[str, dict[str, str]] = {}
    with disk_refusals(path, "cannot be read", RecordingRefused), path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise RecordingRefused(f"{path}: not an MCAP file, expected a recording of twin")
        position = len(MCAP0_MAGIC)
        while position + RECORD_PREFIX <= size:
            file.seek(position)
            opcode, length = struct.unpack("<BQ", file.read(RECORD_PREFIX))
            position += RECORD_PREFIX + length
            if opcode == Opcode.DATA_END or position > size:
                break
            if opcode == Opcode.METADATA and length <= LIMIT:
                try:
                    record = Metadata.read(ReadDataStream(BytesIO(file.read(length))))
                except (McapError, ValueError, struct.error, OverflowError):
                    raise RecordingRefused(
                        f"{path}: not a recording that twin wrote: its metadata is damaged"
                    ) from None
                found.setdefault(record.name, {}).update(record.metadata)
    return found
