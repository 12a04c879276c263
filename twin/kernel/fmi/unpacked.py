"""Unpacked FMUs: one folder per content, which is what the archive holds whenever it is used.

A folder has the files of the archive in `fmu`, and in `seal.json` how they were found when they were last compared:
size, times, inode. What is still found so is not read again."""

import contextlib
import json
import os
import shutil
import stat
import sys
import tempfile
import zipfile
from functools import lru_cache
from pathlib import Path
from typing import NamedTuple

from twin.kernel.archive import place
from twin.kernel.cache_folder import REMEDY, cache_folder, discard_foreign, evict, hold, remove
from twin.kernel.errors import InputRefused, disk_refusals

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


KEPT = 50
"""Folders that are kept in any case; those in use are kept besides."""
_CHUNK = 1 << 20


def unpacked(file: Path, digest: str) -> Path:
    """The folder of the unpacked FMU: made once per content, shared by all runs, never seen half-made.

    A file that was changed or removed since is taken from the archive again, which is said on standard error.

    Args:
        file: the FMU, its archive checked by `archive.entries`.
        digest: its `archive.sha256`.

    Raises:
        InputRefused: it cannot be written there.
    """
    home = cache_folder(HOME)
    folder = home / digest
    with disk_refusals(file, f"cannot be unpacked to {home}", InputRefused, REMEDY):
        discard_foreign(folder)
        while not hold(folder):
            _make(file, digest, folder)
        try:
            mended = _mend(file, digest, folder)
        except OSError:
            # a folder where a file should be, say; what is loaded from it stays loaded
            remove(folder)
            _make(file, digest, folder)
            hold(folder)
            mended = ["all"]
        # who only looks at what is kept does not wait for what reads FMUs
        from twin.kernel.fmi.compiling import supply

        supply(digest, folder / CONTENT)
    if mended:
        listed = ", ".join(mended[:3]) + (f" and {len(mended) - 3} more" if len(mended) > 3 else "")
        told = f"twin: {file.name}: unpacked files had been changed ({listed}): taken from the FMU again"
        print(told, file=sys.stderr)
    return folder / CONTENT


def _make(file: Path, digest: str, folder: Path) -> None:
    """Unpack `file` to `folder`, unless another process does so first."""
    if folder.exists() and not folder.is_dir():
        remove(folder)
    scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name[:12]}-", dir=folder.parent))
    try:
        _mend(file, digest, scratch)
        scratch.rename(folder)
    except OSError:
        if not folder.is_dir():
            raise
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    evict(folder.parent, KEPT)


def _mend(file: Path, digest: str, folder: Path) -> list[str]:
    """Make the files in `folder` those of the archive `file`; returns which were not."""
    content, sealed = folder / CONTENT, sealed_stamps(folder)
    wrong = []
    entries = _entries(file, digest)
    content.mkdir(exist_ok=True)
    for name in entries:
        if name.endswith("/"):
            (content / name).mkdir(parents=True, exist_ok=True)
    files = [name for name in entries if not name.endswith("/")]
    found = {name: stamp_of(f"{content}/{name}") for name in files}
    moved = [name for name in files if found[name] is None or found[name] != sealed.get(name)]
    if not moved:
        return []
    with zipfile.ZipFile(file) as archive:
        for name in moved:
            if found[name] is None or not _is_same(archive, entries[name], content / name):
                _put(archive, entries[name], content)
                found[name] = stamp_of(f"{content}/{name}")
                wrong.append(name)
    with tempfile.NamedTemporaryFile("w", dir=folder, delete=False) as beside:
        json.dump(found, beside)
    os.replace(beside.name, folder / SEAL)
    return wrong


@lru_cache(KEPT)
def _entries(file: Path, digest: str) -> dict[str, zipfile.ZipInfo]:
    """What the archive `file` of that `digest` holds, by its places."""
    with zipfile.ZipFile(file) as archive:
        # the last of two entries with one name is the one that counts
        return {place(info): info for info in archive.infolist()}


def _is_same(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, path: Path) -> bool:
    """Whether the file at `path` holds what the `entry` of `archive` does."""
    try:
        with archive.open(entry) as wanted, path.open("rb") as there:
            while chunk := wanted.read(_CHUNK):
                if chunk != there.read(len(chunk)):
                    return False
            return not there.read(1)
    except PermissionError:
        return False


def _put(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, content: Path) -> None:
    """Take the `entry` of `archive` to its place in `content`; whoever has loaded the old file keeps that."""
    target = content / place(entry)
    if target.is_dir() and not target.is_symlink():
        shutil.rmtree(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, beside = tempfile.mkstemp(dir=target.parent)
    try:
        with archive.open(entry) as packed, os.fdopen(handle, "wb") as stream:
            shutil.copyfileobj(packed, stream, _CHUNK)
        os.replace(beside, target)
    finally:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(beside)
