"""What a sweep keeps outside its folder while it runs, and what of it is left when it is killed.

Folders for temporary files have names that say whose they are, and a named pipe that their process holds open: one that
nobody holds any more is left behind. Semaphores have the name of the folder that they belong to.
"""

import multiprocessing
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

ORDERS, DASK = "twin_sweep_", "twin_dask_"
"""Beginnings of the names of folders: of a worker's orders, and of a cluster of this machine."""
YOUNG = 60.0
"""s; a folder that is younger may not have its pipe yet."""
SEMAPHORES = Path("/dev/shm")
"""Where Linux shows them."""


def clear() -> None:
    """Remove what killed sweeps of this user have left."""
    home = Path(tempfile.gettempdir())
    for folder in (*home.glob(f"{ORDERS}*"), *home.glob(f"{DASK}*")):
        # others may clear, too
        with suppress(OSError):
            found = folder.lstat()
            ours = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid()
            if ours and time.time() - found.st_mtime > YOUNG and not _is_held(folder):
                for semaphore in SEMAPHORES.glob(f"sem.{folder.name}-*"):
                    semaphore.unlink()
                shutil.rmtree(folder, ignore_errors=True)


def hold(pipe: Path) -> int:
    """Make the named `pipe`, alone of its kind in its folder, and open it, at both ends: that waits for nobody."""
    os.mkfifo(pipe)
    return os.open(pipe, os.O_RDWR)


def _is_held(folder: Path) -> bool:
    for entry in os.scandir(folder):
        if stat.S_ISFIFO(entry.stat(follow_symlinks=False).st_mode):
            # to write into a pipe that nobody has open is refused
            with suppress(OSError):
                os.close(os.open(entry.path, os.O_WRONLY | os.O_NONBLOCK))
                return True
    return False


@contextmanager
def dask_folder() -> Iterator[str]:
    """A folder for a cluster of this machine, and its name for the semaphores that are made meanwhile."""
    config = multiprocessing.current_process()._config  # type: ignore[attr-defined]
    before = config.get("semprefix")
    with tempfile.TemporaryDirectory(prefix=DASK, ignore_cleanup_errors=True) as folder:
        held = hold(Path(folder) / "held")
        config["semprefix"] = f"/{Path(folder).name}"
        try:
            yield folder
        finally:
            config["semprefix"] = before
            os.close(held)
