"""What there is of unpacked FMUs, looked at without what unpacks them, see `twin.drive.unpacked`."""

import json
import os
import stat
from pathlib import Path
from typing import NamedTuple

from twin.cache_folder import cache_folder

HOME = "unpacked"
CONTENT, SEAL = "fmu", "seal.json"

Stamp = list[int]


class Shelf(NamedTuple):
    """What is kept in `folder`: FMUs, bytes of the files that they were unpacked to, and those of these that are not
    as they were last found."""

    folder: Path
    drives: int
    size: int
    changed: tuple[Path, ...]


def shelf() -> Shelf:
    """What there is of unpacked FMUs; nothing is mended.

    Raises:
        InputRefused: see `cache_folder`.
    """
    home = cache_folder(HOME)
    folders = [path for path in home.iterdir() if not path.name.startswith(".")]
    size, changed = 0, []
    for folder in folders:
        for name, stamp in sealed_stamps(folder).items():
            path = f"{folder}/{CONTENT}/{name}"
            found = stamp_of(path)
            size += found[0] if found else 0
            if found != stamp:
                changed.append(Path(path))
    return Shelf(home, len(folders), size, tuple(changed))


def sealed_stamps(folder: Path) -> dict[str, Stamp]:
    """How the files in `folder` were last found; nothing if that was damaged, too."""
    try:
        known = json.loads((folder / SEAL).read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    return known if isinstance(known, dict) else {}


def stamp_of(path: str) -> Stamp | None:
    """What changes when the file at `path` is written to, even by who sets its time back; None: no such file."""
    try:
        found = os.lstat(path)
    # a seal that was damaged may name anything
    except (OSError, ValueError):
        return None
    if not stat.S_ISREG(found.st_mode):
        return None
    return [found.st_size, found.st_mtime_ns, found.st_ctime_ns, found.st_ino]
