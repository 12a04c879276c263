"""How far a recording reaches, without reading it: for a sentence about one of any size."""

import os
import struct
from pathlib import Path

from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from twin.recording.messages import RECORD_PREFIX
from twin.recording.series import NANOSECONDS


def last_time(path: Path) -> float | None:
    """Simulation time (s) of the last message in a complete chunk of `path`, finished or not; None if it has no chunk.

    Goes from record to record; a chunk starts with the times of its first and last message
    (https://mcap.dev/spec#chunk-op0x06). Nothing is checked: `reader.read` does that.
    """
    last = None
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        position = len(MCAP0_MAGIC)
        while position + RECORD_PREFIX <= size:
            file.seek(position)
            opcode, length = struct.unpack("<BQ", file.read(RECORD_PREFIX))
            position += RECORD_PREFIX + length
            if opcode == Opcode.CHUNK and position <= size:
                _, last = struct.unpack("<QQ", file.read(16))
    return None if last is None else last / NANOSECONDS
