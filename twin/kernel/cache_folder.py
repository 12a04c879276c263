"""The user's private cache folder: location, ownership and size.

Its content is executed: libraries of FMUs, machine code, pickles. A user who can write to it runs code as its owner.
"""

import contextlib
import os
import re
import stat
import sys
import time
from collections.abc import Iterator
from pathlib import Path

from twin.kernel.errors import InputRefused, translate_disk_errors

try:
    import fcntl
except ImportError:
    # Windows, which refuses to delete files in use anyway
    fcntl = None  # type: ignore[assignment]


CACHE_VARIABLE = "TWIN_CACHE"
CACHE_REMEDY = f"set {CACHE_VARIABLE} to a folder of yours"
PRIVATE_MODE = 0o700
_HASH_NAME = re.compile(r"[0-9a-f]{16,64}")
"""Name of a folder that is identified by a hash of its inputs."""
_ABANDONED_AGE = 24 * 3600.0
"""Age (s) of an unfinished folder above which it counts as abandoned by a killed process."""

_locked_folders: dict[Path, tuple[int, int]] = {}
"""Folder -> (inode, descriptor that holds this process's shared lock)."""


def cache_folder(name: str) -> Path:
    """Create the folder `name` in the user's cache if missing, and return it.

    InputRefused: it belongs to another user or cannot be written, or TWIN_CACHE is invalid.
    """
    return private_folder(private_folder(cache_base()) / name)


def cache_base() -> Path:
    """Return the location of twin's cache: the variable TWIN_CACHE, or the platform's cache folder."""
    given = os.environ.get(CACHE_VARIABLE, "")
    try:
        base = Path(given).expanduser() if given else _default_base()
    except RuntimeError:
        unknown = f"{CACHE_VARIABLE}={given}: no such user" if given else "no home folder is known to keep anything in"
        raise InputRefused(f"{unknown}; {CACHE_REMEDY}") from None
    if not base.is_absolute():
        # processes of one run have different current folders
        place = f"{CACHE_VARIABLE}={given}" if given else f"cache folder {base}"
        raise InputRefused(f"{place}: a relative path; expected an absolute path, or ~/...")
    return base


def private_folder(folder: Path) -> Path:
    """Check that only the user can write to `folder`, create it if missing, and return it; else InputRefused."""
    with translate_disk_errors(folder, "cannot be made a cache folder", InputRefused, CACHE_REMEDY):
        try:
            found = folder.stat()
        except FileNotFoundError:
            folder.mkdir(PRIVATE_MODE, parents=True, exist_ok=True)
            found = folder.stat()
        link = folder.lstat()
    if not stat.S_ISDIR(found.st_mode):
        raise InputRefused(f"{folder}: not a folder; remove it, or {CACHE_REMEDY}")
    risk = "and its content is executed"
    if owner := _owner_problem(link, found):
        raise InputRefused(f"{folder}: {owner}, {risk}; {CACHE_REMEDY}")
    if open_ := _permission_problem(found):
        raise InputRefused(f"{folder}: {open_}, {risk}; {CACHE_REMEDY}, or remove that permission if it was not used")
    if not os.access(folder, os.R_OK | os.W_OK | os.X_OK):
        raise InputRefused(f"{folder}: cannot be written; {CACHE_REMEDY}")
    return folder


def discard_foreign(path: Path) -> None:
    """Remove `path` below a `private_folder` if it, or anything in it, is accessible to other users, or OSError.

    Another user may have created it while the parent folder was open to others. Reported on standard error.
    """
    if why := ownership_problem(path):
        # another process may have removed it first
        with contextlib.suppress(FileNotFoundError):
            remove(path)
        print(f"twin: {why}: removed, because its content is executed", file=sys.stderr)


def ownership_problem(path: Path) -> str:
    """Return an error message if `path` or an entry below it is not private to the user; else "", also if missing."""
    if not hasattr(os, "geteuid"):
        return ""
    try:
        # check the link first: its target may be inaccessible
        why = _owner_problem(path.lstat())
        if not why:
            found = path.stat()
            why = _owner_problem(found) or _permission_problem(found)
    # missing, or a dangling link; another process may remove it meanwhile
    except FileNotFoundError:
        return ""
    if why:
        return f"{path}: {why}"
    # entries of a folder that others cannot enter may have any mode, such as the umask's
    entered = found.st_mode & (stat.S_IXGRP | stat.S_IXOTH)
    for entry in _entries_below(path) if stat.S_ISDIR(found.st_mode) else ():
        with contextlib.suppress(FileNotFoundError):
            inner = entry.stat(follow_symlinks=False)
            if why := _owner_problem(inner) or (_permission_problem(inner) if entered else ""):
                return f"{entry.path}: {why}"
    return ""


def _owner_problem(*found: os.stat_result) -> str:
    if not hasattr(os, "geteuid"):
        return ""
    others = {_owner(one) for one in found} - {os.geteuid()}
    return f"belongs to user {others.pop()}, not to you (user {os.geteuid()})" if others else ""


def _owner(found: os.stat_result) -> int:
    return found.st_uid


def _permission_problem(found: os.stat_result) -> str:
    """Return an error message if other users can write to the file `found`; else "". A link's mode is meaningless."""
    if not hasattr(os, "geteuid") or stat.S_ISLNK(found.st_mode) or not found.st_mode & (stat.S_IWGRP | stat.S_IWOTH):
        return ""
    return f"others can write to it (mode {stat.S_IMODE(found.st_mode):o})"


def lock_against_eviction(folder: Path) -> bool:
    """Lock a cache folder while this process lives and mark it as used; return whether it exists. OSError: unusable."""
    try:
        os.utime(folder)
        inode = folder.stat().st_ino
        if folder in _locked_folders:
            if _locked_folders[folder][0] == inode:
                return True
            os.close(_locked_folders.pop(folder)[1])
        if fcntl is None:
            return folder.is_dir()
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    except (FileNotFoundError, NotADirectoryError):
        return False
    # without locks on this file system an evicting process cannot lock either
    with contextlib.suppress(OSError):
        fcntl.flock(descriptor, fcntl.LOCK_SH)
    # it may have been evicted while this process waited for the lock
    with contextlib.suppress(FileNotFoundError):
        if folder.stat().st_ino == inode == os.fstat(descriptor).st_ino:
            _locked_folders[folder] = inode, descriptor
            return True
    os.close(descriptor)
    return False


def _entries_below(folder: str | os.PathLike[str]) -> Iterator["os.DirEntry[str]"]:
    """Yield all files and folders below `folder`, a folder before its entries; pathlib would take ten times as long."""
    folders: list[str | os.PathLike[str]] = [folder]
    while folders:
        # another process may remove it meanwhile
        with contextlib.suppress(OSError), os.scandir(folders.pop()) as entries:
            for entry in entries:
                yield entry
                if entry.is_dir(follow_symlinks=False):
                    folders.append(entry.path)


def evict(home: Path, most: int, names: re.Pattern[str] = _HASH_NAME) -> None:
    """Remove the least recently used entries of a `private_folder` until `most` remain; locked ones stay.

    Entries whose name does not match `names` stay too. Abandoned unfinished folders are removed.
    """
    used: list[tuple[float, Path]] = []
    for entry in home.iterdir():
        # another process may be evicting
        with contextlib.suppress(OSError):
            used.append((entry.stat().st_mtime, entry))
    counted = [entry for _, entry in sorted(used, reverse=True) if names.fullmatch(entry.name)]
    for old in counted[most:]:
        with contextlib.suppress(OSError), _exclusive_lock(old):
            remove(old)
    for last, entry in used:
        if entry.name.startswith(".") and time.time() - last > _ABANDONED_AGE:
            with contextlib.suppress(OSError):
                _delete(entry)


def remove(path: Path) -> None:
    """Remove the folder or file `path` atomically, by renaming it before its deletion; OSError if that fails."""
    aside = path.with_name(f".{path.name[:12]}-{os.getpid()}-{time.monotonic_ns()}")
    path.rename(aside)
    _delete(aside)


def _delete(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        # imported here: most commands delete nothing, and shutil imports compression libraries
        import shutil

        # another user's folder may stay: it has been renamed
        with contextlib.suppress(PermissionError):
            path.chmod(PRIVATE_MODE)
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink()


@contextlib.contextmanager
def _exclusive_lock(folder: Path) -> Iterator[None]:
    """Hold an exclusive lock on `folder` during the block; raise `OSError` if another process has locked it."""
    if fcntl is None:
        yield
        return
    # non-blocking: a pipe at this path would block
    descriptor = os.open(folder, os.O_RDONLY | os.O_NONBLOCK)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        yield
    finally:
        os.close(descriptor)


def _default_base() -> Path:
    """Return the platform's default cache folder for applications; relative XDG base directories are ignored."""
    if sys.platform == "win32":
        local = os.environ.get("LOCALAPPDATA", "")
        return (Path(local) if local else Path.home() / "AppData" / "Local") / "twin"
    if sys.platform == "darwin":
        return Path.home() / "Library" / "Caches" / "twin"
    given = Path(os.environ.get("XDG_CACHE_HOME", ""))
    return (given if given.is_absolute() else Path.home() / ".cache") / "twin"
