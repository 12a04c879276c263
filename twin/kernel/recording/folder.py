"""Folders of runs, results/<experiment>/<run>/run.mcap, and the growing file of a recording.

The file is `NAME.mcap.partial` until it is finished, and never ends in half a record.
"""

import contextlib
import os
import re
import zlib
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path
from typing import BinaryIO

from twin.kernel.atomic_write import make_folder, write_text
from twin.kernel.errors import RecordingError, RecordingWriteError, translate_disk_errors
from twin.kernel.files import suggestion

RESULTS_FOLDER = Path("results")
RECORDING_FILE = "run.mcap"
LATEST_LINK = "latest"
FOLDER_STAMP = re.compile(r"\d{4}-\d{2}-\d{2}_\d{6}(_\d+)?")
"""Names that `create_run_folder` gives to the folders of runs."""
NAMED_NOTE_FILE = "named.txt"
"""Marker file in a folder whose user-chosen name looks like one from `create_run_folder`."""
PARTIAL_SUFFIX = ".partial"


def create_run_folder(results: Path, experiment: str, now: datetime) -> Path:
    """Create a new folder results/<experiment>/<time>/ and link results/<experiment>/latest to it."""
    home = make_folder(results / experiment)
    stamp = now.strftime("%Y-%m-%d_%H%M%S")
    for attempt in range(1, 1000):
        folder = home / (stamp if attempt == 1 else f"{stamp}_{attempt}")
        refusals = translate_disk_errors(folder, "cannot be created", RecordingError, "choose with --out")
        with refusals, contextlib.suppress(FileExistsError):
            folder.mkdir()
            break
    _link_latest(home / LATEST_LINK, folder.name)
    return folder


def discard_run_folder(folder: Path) -> None:
    """Remove the empty folder of a run and link `latest` to the previous run again."""
    try:
        folder.rmdir()
    except OSError:
        return
    before = [one.name for one in folder.parent.iterdir() if one.is_dir() and FOLDER_STAMP.fullmatch(one.name)]
    # the tenth run within a second, _10, sorts before _2 but is later
    _link_latest(folder.parent / LATEST_LINK, max(before, key=lambda name: (name[:17], len(name), name), default=None))


def _link_latest(latest: Path, run: str | None) -> None:
    # Windows restricts links to administrators; `recording_in` then uses the newest folder
    with contextlib.suppress(OSError):
        latest.unlink(missing_ok=True)
        if run is not None:
            latest.symlink_to(run, target_is_directory=True)


def claim_run_folder(folder: Path) -> Path:
    """Create the user's `folder` for one run; a name like `create_run_folder`'s gets a marker: all commands keep it."""
    with translate_disk_errors(folder, "cannot be read", RecordingError):
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise RecordingError(f"{folder}: exists and is not empty; name a new folder, a run is never overwritten")
    make_folder(folder)
    if FOLDER_STAMP.fullmatch(folder.name):
        write_text(folder / NAMED_NOTE_FILE, "twin runs --prune leaves this run: its folder was named with --out\n")
    return folder


def new_run_folder(out: str | Path | None, results: Path, experiment: str) -> Path:
    """Create the folder of one run: `out` as the user named it, or results/<experiment>/<time>/ without it."""
    return claim_run_folder(Path(out)) if out else create_run_folder(results, experiment, datetime.now())


def recording_in(path: Path) -> Path:
    """Find the recording at `path`, .mcap file or folder (of an experiment: its latest run), else RecordingError."""
    # Path.is_file raises for a name that is too long
    if os.path.isfile(path):
        return path
    latest = path / LATEST_LINK
    # resolve the link: a printed path with `latest` in it would mean another run after the next one
    runs = [path, path / os.readlink(latest) if os.path.islink(latest) else latest]
    if os.path.isdir(path):
        runs += sorted((f for f in path.iterdir() if f.is_dir()), reverse=True)
    for folder in runs:
        for name in (RECORDING_FILE, f"{RECORDING_FILE}.partial"):
            if os.path.isfile(folder / name):
                return folder / name
    hint = "" if os.path.exists(path) else suggestion(RESULTS_FOLDER / path) or suggestion(path)
    hint = hint or "; expected an .mcap file, a run's folder or results/<experiment>"
    raise RecordingError(f"{path}: no recording{hint}")


class Output:
    """An append-only file, `partial` while it grows, renamed to `path` when complete; bytes appended, their CRC-32."""

    def __init__(self, path: Path) -> None:
        """Create the partial file for appending, replacing an existing one."""
        self.path = path
        self.partial = path.with_name(path.name + PARTIAL_SUFFIX)
        self.size = 0
        self.crc = 0
        with translate_disk_errors(self.partial, "cannot be created", RecordingWriteError):
            # unbuffered: appended bytes are with the operating system and survive the end of this process
            self._file: BinaryIO | None = open(self.partial, "wb", buffering=0)  # noqa: SIM115

    @property
    def closed(self) -> bool:
        return self._file is None

    def append(self, data: bytes | Iterable[bytes]) -> int:
        """Append all of `data`, in one piece or several, or nothing, to the file; return its offset in the file.

        After RecordingWriteError (disk full, too large, closed) or an interrupt, it is closed at its former size.
        """
        if self._file is None:
            raise RecordingWriteError(f"{self.partial}: the recording is closed")
        size, crc = self.size, self.crc
        remedy = f"the {self.size} bytes already written stay readable"
        with translate_disk_errors(self.partial, "recording stopped", RecordingWriteError, remedy):
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
        """Close the unfinished file under its partial name."""
        if self._file is not None:
            self._file.close()
            self._file = None

    def publish(self) -> None:
        """Sync, close and rename the file to its final name, replacing any; RecordingWriteError leaves the partial."""
        if self._file is None:
            raise RecordingWriteError(f"{self.partial}: the recording is closed")
        with translate_disk_errors(self.partial, "cannot be finished", RecordingWriteError):
            try:
                os.fsync(self._file.fileno())
            finally:
                self.close()
            os.replace(self.partial, self.path)
