"""Output files: written whole or not at all; the previous file stays until then."""

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
    """`folder`, which is there from now on.

    Raises:
        InputRefused: it cannot be created.
    """
    with translate_disk_errors(folder, "cannot be created", InputRefused, caught=PATH_ERRORS):
        folder.mkdir(parents=True, exist_ok=True)
    return folder


@contextlib.contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """A file beside `path` to write to, which takes the place of `path` when the block is done, and not before.

    Folders that are missing are created. A link is followed: what it points to is replaced, the link stays.

    Raises:
        InputRefused: there is a folder, a pipe or a device at `path`, which a file must not replace.
        NotWritten: the folder or the disk refuses; a file that was at `path` is what it was.
    """
    with translate_disk_errors(path, caught=PATH_ERRORS):
        target = Path(os.path.realpath(path))
        if target.exists() and not target.is_file():
            kind = "a folder" if target.is_dir() else "a pipe or device"
            raise InputRefused(f"{path}: {kind}; expected the name of a file, which is replaced if it is there")
        # where a file has the place of the folder, mkdir would say that it exists
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
                # some disks tell only here that they are full
                os.fsync(file.fileno())
            # mkstemp makes it the owner's alone; what a command writes is as readable as any other file
            beside.chmod(0o666 & ~_umask())
            beside.replace(target)
    finally:
        with contextlib.suppress(OSError):
            beside.unlink()


def refuse_unwritable(path: Path) -> None:
    """Refuse what `atomic_write` would refuse of `path`, before there is anything to write; missing folders are created.

    Raises:
        InputRefused: there is a folder, a pipe or a device at `path`.
        NotWritten: the folder refuses.
    """
    with contextlib.suppress(_DryRunEnd), atomic_write(path):
        raise _DryRunEnd


class _DryRunEnd(Exception):
    """There is nothing to write yet."""


@contextlib.contextmanager
def open_unbuffered(path: Path) -> Iterator[Callable[[str], None]]:
    """A file begun anew at `path`, and what appends a text to it: whatever then ends the process, the text stays.

    Raises:
        NotWritten: the folder or the disk refuses; also what appends raises that.
    """

    def append(text: str) -> None:
        rest = text.encode("utf-8")
        with translate_disk_errors(path):
            while rest:
                rest = rest[file.write(rest) :]

    with translate_disk_errors(path, caught=PATH_ERRORS):
        # unbuffered: what `append` returned from is with the operating system
        file = path.open("wb", buffering=0)
    with file:
        yield append


def write_bytes(path: Path, content: bytes) -> None:
    """Make `content` that of the file at `path`.

    Raises:
        NotWritten: as `atomic_write`.
    """
    with atomic_write(path) as beside:
        beside.write_bytes(content)


def write_text(path: Path, text: str) -> None:
    """Make `text`, in UTF-8, the content of the file at `path`.

    Raises:
        NotWritten: as `atomic_write`.
    """
    write_bytes(path, text.encode("utf-8"))


def write_json(path: Path, facts: Any) -> None:
    """Make `facts` the content of the JSON file at `path`, as `json_text` writes them.

    Raises:
        NotWritten: as `atomic_write`.
    """
    write_text(path, json_text(facts, indent=2) + "\n")


def json_text(facts: Any, indent: int | None = None) -> str:
    """`facts` as JSON, which knows no infinity and nothing that is not a number: both become null."""
    try:
        return json.dumps(facts, indent=indent, allow_nan=False)
    except ValueError:
        return json.dumps(to_dict(facts), indent=indent, allow_nan=False)


def inline_table(facts: Mapping[str, Any]) -> Any:
    """`facts` as a table of TOML on one line, for tomlkit to write."""
    # takes some 30 ms to import, which commands that write no TOML need not spend
    from tomlkit import inline_table

    table = inline_table()
    table.update(facts)
    return table


def _umask() -> int:
    # there is no way to read it without setting it
    mask = os.umask(0o022)
    os.umask(mask)
    return mask
