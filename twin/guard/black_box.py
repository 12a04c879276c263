"""Memory that outlives the process which writes it: who was being stepped, when, with which inputs.

A file without a name, open in two processes. The writer maps it and pays a store per value (see
`twin.guard.voice.Voice.stepping`); the reader asks the operating system for the bytes when it wants to know.

Layout, native byte order: tick int64, component int64; from byte `INPUTS_AT` on the inputs of all components, float64.
"""

import os
import struct
import tempfile

INPUTS_AT = 64
"""A cache line of its own for the mark."""
_MARK = struct.Struct("=qq")


class BlackBox:
    """The reader's end; a context manager that gives the memory back.

    Attributes:
        fd: of the nameless file, to be inherited by the writer.
    """

    def __init__(self) -> None:
        if hasattr(os, "memfd_create"):
            self.fd = os.memfd_create("twin black box")
        else:
            with tempfile.TemporaryFile() as file:
                self.fd = os.dup(file.fileno())
        os.ftruncate(self.fd, INPUTS_AT)

    def mark(self) -> tuple[int, int]:
        """(tick, component) of the step that is running or was the last to begin; see `SimulationMemory.mark`."""
        tick, component = _MARK.unpack(os.pread(self.fd, _MARK.size, 0))
        return tick, component

    def inputs(self, start: int, count: int) -> tuple[float, ...]:
        """`count` of the inputs of all components from number `start` on, as the last steps saw them."""
        return struct.unpack(f"={count}d", os.pread(self.fd, 8 * count, INPUTS_AT + 8 * start))

    def close(self) -> None:
        os.close(self.fd)
