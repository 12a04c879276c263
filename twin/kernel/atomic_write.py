"""Output files, written completely or not at all; until then the previous file stays."""

import contextlib
import errno
import json
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from twin.kernel.errors import PATH_ERRORS, InputRefused, translate_disk_errors
from twin.kernel.serialise import to_dict


def make_folder(folder: Path) -> Path:
    """Create `folder` with its parents if missing, and return it."""
    with translate_disk_errors(folder, "cannot be created", InputRefused, caught=PATH_ERRORS):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Write a file atomically: yield a temporary path in its folder, and rename that to `path` if the block succeeds.

    Missing folders are created. A link is followed: its target is replaced, the link stays. InputRefused: a folder,
    pipe or device is at `path`. NotWritten: the folder or the disk refuses, and an existing file is unchanged.
    """
    with translate_disk_errors(path, caught=PATH_ERRORS):
        target = Path(os.path.realpath(path))
        if target.exists() and not target.is_file():
            kind = "a folder" if target.is_dir() else "a pipe or device"
            raise InputRefused(f"{path}: {kind}; expected the name of a file, which is replaced if it is there")
        # if the parent is a file, mkdir would report "file exists"
        if target.parent.is_file():
            raise NotADirectoryError(errno.ENOTDIR, os.strerror(errno.ENOTDIR))
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(prefix=f".{target.stem[:60]}.", suffix=target.suffix, dir=target.parent)
        os.close(handle)
    beside = Path(name)
    try:
        with translate_disk_errors(path):
            yield beside
            with beside.open("r+b") as file:
                # some file systems report a full disk only at fsync
                os.fsync(file.fileno())
            # mkstemp restricts access to the owner; use the permissions of any other new file
            mask = os.umask(0o022)
            # os.umask can only be read by setting it
            os.umask(mask)
            beside.chmod(0o666 & ~mask)
            beside.replace(target)
    finally:
        with contextlib.suppress(OSError):
            beside.unlink()


def refuse_unwritable(path: Path) -> None:
    """Check that a file could be written to `path`, before there is data to write; create missing folders."""
    with contextlib.suppress(_DryRunEnd), atomic_write(path):
        raise _DryRunEnd


class _DryRunEnd(Exception):
    """Exception that ends a dry run of writing a file, so that nothing is written."""


@contextlib.contextmanager
def open_unbuffered(path: Path) -> Iterator[Callable[[str], None]]:
    """Truncate the file at `path` and yield a function that appends text to it, which survives a crash."""

    def append(text: str) -> None:
        rest = text.encode("utf-8")
        with translate_disk_errors(path):
            while rest:
                rest = rest[file.write(rest) :]

    with translate_disk_errors(path, caught=PATH_ERRORS):
        # unbuffered: appended text is with the operating system when `append` returns
        file = path.open("wb", buffering=0)
    with file:
        yield append


def write_bytes(path: Path, content: bytes) -> None:
    """Write bytes to the file at `path`, atomically, see `atomic_write`."""
    with atomic_write(path) as beside:
        beside.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Write text in UTF-8 to the file at `path`, atomically, see `atomic_write`."""
    write_bytes(path, text.encode("utf-8"))


def write_json(path: Path, facts: Any) -> None:
    """Write `facts` as JSON to the file at `path`, atomically, see `json_text`."""
    write_text(path, json_text(facts, indent=2) + "\n")


def json_text(facts: Any, indent: int | None = None) -> str:
    """Encode mappings, lists and numbers as JSON text; infinity and NaN, which JSON lacks, become null."""
    try:
        return json.dumps(facts, indent=indent, allow_nan=False)
    except ValueError:
        return json.dumps(to_dict(facts), indent=indent, allow_nan=False)


def inline_table(facts: Mapping[str, Any]) -> Any:
    """Convert the mapping `facts` to an inline TOML table, for tomlkit to write."""
    # imported here: it takes about 30 ms, which most commands need not spend
    from tomlkit import inline_table

    table = inline_table()
    table.update(facts)
    return table
