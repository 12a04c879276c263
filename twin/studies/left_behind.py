"""Temporary folders and semaphores of killed studies: found and removed.

A folder's name says what it is for, and its process holds a named pipe in it open: a folder whose pipe has no holder
was left behind. Semaphores have the name of the folder that they belong to.
"""

import os
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

ORDERS, SCRATCH, DASK = "twin_sweep_", "twin_scratch_", "twin_dask_"
"""Beginnings of the names of folders: orders of a worker, recordings that are not kept, a cluster of this machine."""
YOUNG = 60.0
"""s; a folder that is younger may not have its pipe yet."""
SEMAPHORES = Path("/dev/shm")
"""Where Linux shows them."""


def clear() -> None:
    """Remove what killed studies of this user have left."""
    home = Path(tempfile.gettempdir())
    for folder in (folder for kind in (ORDERS, SCRATCH, DASK) for folder in home.glob(f"{kind}*")):
        # others may clear, too
        with suppress(OSError):
            found = folder.lstat()
            ours = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid()
            if ours and time.time() - found.st_mtime > YOUNG and not _is_held(folder):
                for semaphore in SEMAPHORES.glob(f"sem.{folder.name}-*"):
                    semaphore.unlink()
                shutil.rmtree(folder, ignore_errors=True)


def hold(pipe: Path) -> int:
    """Make the named `pipe`, alone of its kind in its folder, and open it at both ends, which does not block."""
    os.mkfifo(pipe)
    return os.open(pipe, os.O_RDWR)


def _is_held(folder: Path) -> bool:
    for entry in os.scandir(folder):
        if stat.S_ISFIFO(entry.stat(follow_symlinks=False).st_mode):
            # to write into a pipe without a reader is refused
            with suppress(OSError):
                os.close(os.open(entry.path, os.O_WRONLY | os.O_NONBLOCK))
                return True
    return False


@contextmanager
def held_folder(kind: str) -> Iterator[Path]:
    """A temporary folder that is held until the end of the block, and is then removed."""
    with tempfile.TemporaryDirectory(prefix=kind, ignore_cleanup_errors=True) as folder:
        held = hold(Path(folder) / "held")
        try:
            yield Path(folder)
        finally:
            os.close(held)


@contextmanager
def dask_folder() -> Iterator[Path]:
    """A folder for a cluster of this machine, and its name for the semaphores that are made meanwhile."""
    # here, for every command of twin clears
    import multiprocessing

    config = multiprocessing.current_process()._config  # type: ignore[attr-defined]
    before = config.get("semprefix")
    with held_folder(DASK) as folder:
        config["semprefix"] = f"/{folder.name}"
        try:
            yield folder
        finally:
            config["semprefix"] = before
