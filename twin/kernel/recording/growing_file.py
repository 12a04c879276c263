"""The file a recording grows in: `NAME.mcap.partial` until finished, never with half a record at its end."""

import contextlib
import os
import zlib
from collections.abc import Iterable
from pathlib import Path
from typing import BinaryIO

from twin.kernel.errors import RecordingFailed, disk_refusals

PARTIAL = ".partial"


class Output:
    """Append-only file that is renamed to `path` when it is complete.

    Attributes:
        path: where the finished file will be.
        partial: where it grows.
        size: bytes appended.
        crc: CRC-32 of all of them.
    """

    def __init__(self, path: Path) -> None:
        """Create the partial file, replacing one of that name.

        Raises:
            RecordingFailed: it cannot be created.
        """
        self.path = path
        self.partial = path.with_name(path.name + PARTIAL)
        self.size = 0
        self.crc = 0
        with disk_refusals(self.partial, "cannot be created", RecordingFailed):
            # unbuffered: what `append` returned from is with the operating system and survives this process
            self._file: BinaryIO | None = open(self.partial, "wb", buffering=0)  # noqa: SIM115

    @property
    def closed(self) -> bool:
        """Whether nothing can be appended any more."""
        return self._file is None

    def append(self, data: bytes | Iterable[bytes]) -> int:
        """Append all of `data`, in one piece or several, or nothing; return the offset at which it starts.

        After a failure, or an interrupt halfway, the file ends where `data` would have begun and is closed.

        Raises:
            RecordingFailed: the operating system refuses: disk full, file too large, closed file.
        """
        if self._file is None:
            raise RecordingFailed(f"{self.partial}: the recording is closed")
        size, crc = self.size, self.crc
        remedy = f"the {self.size} bytes already written stay readable"
        with disk_refusals(self.partial, "recording stopped", RecordingFailed, remedy):
            try:
                for piece in (data,) if isinstance(data, bytes) else data:
                    rest = memoryview(piece)
                    while rest:
                        rest = rest[self._file.write(rest) :]
                    size, crc = size + len(piece), zlib.crc32(piece, crc)
            except BaseException:
                with contextlib.suppress(OSError):
                    self._file.truncate(self.size)
                self.close()
                raise
        start, self.size, self.crc = self.size, size, crc
        return start

    def close(self) -> None:
        """Close the file and leave it as it is."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def publish(self) -> None:
        """Force the file to the disk, close it and give it its final name, replacing a file of that name.

        Raises:
            RecordingFailed: the disk or the folder refuses; the partial file stays.
        """
        if self._file is None:
            raise RecordingFailed(f"{self.partial}: the recording is closed")
        with disk_refusals(self.partial, "cannot be finished", RecordingFailed):
            try:
                os.fsync(self._file.fileno())
            finally:
                self.close()
            os.replace(self.partial, self.path)
