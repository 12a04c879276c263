"""Memory that outlives the process which writes it: who was being called or stepped, when, with which inputs.

A file without a name, open in two processes. The writer maps it and pays a store per value (see
`twin.runs.guard.reporter.PipeReporter`), so the reader is not woken by what it need not know unless the writer dies;
it asks the operating system for the bytes when it wants to know.

Layout, native byte order: tick int64, component int64; from byte `_COMPILED_AT` on how long the writer has compiled and
since when it does so (ns, int64, of the system's clock; 0: it does not); from byte `_CALL_AT` on a call outside the
steps, its number and length int64 and its text; from byte `INPUTS_AT` on the inputs of all components, float64.
"""

import mmap
import os
import struct
import tempfile
import time
from typing import NamedTuple

INPUTS_AT = 1024
_COMPILED_AT = 32
_CALL_AT = 64
"""A cache line of its own for the mark."""
_MARK = _COMPILED = _CALL = struct.Struct("=qq")
_TEXT_AT = _CALL_AT + _CALL.size
_LONGEST = 255
"""Bytes of each of the three parts of a call's text that are kept; as long as the name of a file may be."""


class Call(NamedTuple):
    """A call into a component that has been announced and has not returned; `number` counts those of its process."""

    number: int
    file: str
    instance: str
    function: str


class BlackBox:
    """The reader's end; a context manager that gives the memory back.

    Attributes:
        fd: of the nameless file, to be inherited by the writer.
    """

    def __init__(self) -> None:
        # Windows has no fcntl, and no guarded processes either
        import fcntl

        if hasattr(os, "memfd_create"):
            fd = os.memfd_create("twin black box")
        else:
            with tempfile.TemporaryFile() as file:
                fd = os.dup(file.fileno())
        # where a standard stream is closed it would get its number, which is another file in the child
        self.fd = fcntl.fcntl(fd, fcntl.F_DUPFD_CLOEXEC, 3)
        os.close(fd)
        os.ftruncate(self.fd, INPUTS_AT)

    def mark(self) -> tuple[int, int]:
        """(tick, component) of the step that is running or was the last to begin; see `SimulationMemory.mark`."""
        tick, component = _MARK.unpack(os.pread(self.fd, _MARK.size, 0))
        return tick, component

    def compiled(self) -> float:
        """How long the writer has compiled until now (s)."""
        done, since = _COMPILED.unpack(os.pread(self.fd, _COMPILED.size, _COMPILED_AT))
        return 1e-9 * (done + (max(time.monotonic_ns() - since, 0) if since else 0))

    def call(self) -> Call | None:
        """The call that has been announced last, if it has not returned."""
        content = os.pread(self.fd, INPUTS_AT - _CALL_AT, _CALL_AT)
        number, length = _CALL.unpack_from(content)
        if not length:
            return None
        text = content[_CALL.size : _CALL.size + length].decode(errors="replace")
        # a living writer may be half-way through the next one
        file, instance, function, *_ = [*text.split("\0"), "", ""]
        return Call(number, file, instance, function)

    def inputs(self, start: int, count: int) -> tuple[float, ...]:
        """`count` of the inputs of all components from number `start` on, as the last steps saw them."""
        return struct.unpack(f"={count}d", os.pread(self.fd, 8 * count, INPUTS_AT + 8 * start))

    def close(self) -> None:
        os.close(self.fd)


class Announcer:
    """The writer's end for calls, and for the time in which there are none because something is compiled.

    Args:
        fd: of the nameless file.
    """

    def __init__(self, fd: int):
        self._memory = mmap.mmap(fd, INPUTS_AT)
        self._number = 0
        self._compiled, self._since = 0, 0

    def compiling(self, begins: bool) -> None:
        """Something is being compiled from now on, or no more. Fits `twin.compiled.compiling.watch_compiling`."""
        now = time.monotonic_ns()
        if not begins:
            self._compiled += now - self._since
        self._since = now if begins else 0
        _COMPILED.pack_into(self._memory, _COMPILED_AT, self._compiled, self._since)

    def tell(self, file: str, instance: str, function: str) -> None:
        """A call begins; with function "" it has returned. Fits `twin.drive.calls.listen`."""
        _CALL.pack_into(self._memory, _CALL_AT, self._number, 0)
        if function:
            text = b"\0".join(part.encode()[:_LONGEST] for part in (file, instance, function))
            self._memory[_TEXT_AT : _TEXT_AT + len(text)] = text
            self._number += 1
            # the length comes last: a process that is ended while it writes has not called yet
            _CALL.pack_into(self._memory, _CALL_AT, self._number, len(text))
