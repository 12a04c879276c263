"""Removal of temporary folders left behind by killed studies.

The process of a folder keeps a named pipe in it open: a folder whose pipe is closed was left behind.
"""

import os
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

FOLDER_PREFIX = "twin_scratch_"
MIN_AGE = 60.0
"""Minimum age (s) of a folder that is removed: a younger one may not have its pipe yet."""


def remove_stale_folders() -> None:
    """Remove the temporary folders that killed studies of this user have left behind."""
    for folder in Path(tempfile.gettempdir()).glob(f"{FOLDER_PREFIX}*"):
        # another command may remove it at the same time
        with suppress(OSError):
            found = folder.lstat()
            own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid()
            if own and time.time() - found.st_mtime > MIN_AGE and not _is_held(folder):
                shutil.rmtree(folder, ignore_errors=True)


def _is_held(folder: Path) -> bool:
    for entry in os.scandir(folder):
        if stat.S_ISFIFO(entry.stat(follow_symlinks=False).st_mode):
            # writing into a pipe without a reader is refused
            with suppress(OSError):
                os.close(os.open(entry.path, os.O_WRONLY | os.O_NONBLOCK))
                return True
    return False


@contextmanager
def held_folder() -> Iterator[Path]:
    """Yield a temporary folder that other studies recognise as used; it is removed at the end of the block."""
    with tempfile.TemporaryDirectory(prefix=FOLDER_PREFIX, ignore_cleanup_errors=True) as folder:
        pipe = Path(folder) / "held"
        os.mkfifo(pipe)
        # opened for reading and writing, which does not block
        held = os.open(pipe, os.O_RDWR)
        try:
            yield Path(folder)
        finally:
            os.close(held)
