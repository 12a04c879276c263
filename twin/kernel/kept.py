"""Answers that are kept between processes, because to make them takes longer than to print them.

An answer is a text, known by the hash of everything that it was made of: whoever changes any of it gets another one,
and nobody has to tell. What is damaged, or cannot be kept, is made again.
"""

import contextlib
import functools
import hashlib
import os
import stat
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from twin.kernel.cache_folder import cache_folder, evict, foreign
from twin.kernel.errors import InputRefused
from twin.kernel.places import PACKAGE, sources

HOME = "answers"
KEPT = 50
MOST_BYTES = 64 << 20
"""Of files that are read to know whether an answer is still right."""


def kept(
    name: str,
    make: Callable[[], str],
    made_of: Callable[[], str | None] = lambda: "",
    lasts: Callable[[], bool] = lambda: True,
    rooms: tuple[str, ...] = (),
) -> str:
    """The answer that `make` gives, made once for all processes.

    Args:
        name: of the question.
        made_of: what the answer is made of besides twin and the packages, as of `contents`; None: it cannot be kept.
        lasts: whether it is made of nothing else; asked when it has been made.
        rooms: folders of twin such as "cli" whose source it is made with, besides the files above them; none: all.
    """
    file = _place(name, made_of, rooms)
    answer = _read(file) if file else None
    if answer is not None:
        return answer
    answer = make()
    # somebody may have changed something meanwhile
    _packages.cache_clear()
    sources.cache_clear()
    if file and lasts() and file == _place(name, made_of, rooms):
        # it is there for the next time if the disk takes it
        with contextlib.suppress(OSError):
            _write(file, answer)
            evict(file.parent, KEPT)
    return answer


def contents(folder: Path) -> str | None:
    """A text that changes with every name and every byte of what lies in `folder`; None if that cannot be told.

    It cannot where a link leads elsewhere, something is no file, or there is more than `MOST_BYTES`.
    """
    digest = hashlib.sha256()
    size = 0
    try:
        for place, mode, length in sorted(_entries(str(folder))):
            size += length
            if size > MOST_BYTES or not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
                return None
            digest.update(_framed(_encoded(place)))
            if stat.S_ISREG(mode):
                digest.update(_framed(Path(place).read_bytes()))
    except OSError:
        return None
    return digest.hexdigest()


def _entries(folder: str) -> Iterator[tuple[str, int, int]]:
    """Path, mode and size of what lies in `folder`, but for what Python compiles."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.name == "__pycache__":
                continue
            found = entry.stat(follow_symlinks=False)
            directory = stat.S_ISDIR(found.st_mode)
            yield entry.path, found.st_mode, 0 if directory else found.st_size
            if directory:
                yield from _entries(entry.path)


def _place(name: str, made_of: Callable[[], str | None], rooms: tuple[str, ...]) -> Path | None:
    """The file of the answer; None if it has none."""
    try:
        said = made_of()
        if said is None:
            return None
        files = (part for file, text in sources(str(PACKAGE), *rooms).items() for part in (_encoded(file), text))
        return cache_folder(HOME) / _hash(_encoded(name), _encoded(said), _python(), *files, *_packages())
    except (InputRefused, OSError):
        return None


def _python() -> bytes:
    """What runs, and where."""
    machine = os.uname().machine if hasattr(os, "uname") else os.environ.get("PROCESSOR_ARCHITECTURE", "")
    return repr((sys.version, sys.platform, machine, sys.flags.optimize, str(PACKAGE))).encode()


@functools.cache
def _packages() -> tuple[bytes, ...]:
    """Where each package that may be imported is, and when it was installed."""
    found = []
    for folder in sys.path:
        try:
            names = sorted(os.listdir(folder or "."))
        # it is not there, or an archive
        except OSError:
            continue
        for name in names:
            if name.endswith(".dist-info"):
                place = f"{folder}/{name}/METADATA"
                found.append(_encoded(place))
                with contextlib.suppress(OSError):
                    there = os.stat(place)
                    found.append(f"{there.st_size} {there.st_mtime_ns}".encode())
    return tuple(found)


def _hash(*parts: bytes) -> str:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(_framed(part))
    return digest.hexdigest()


def _encoded(text: str) -> bytes:
    """`text`, in which names of files may be of any bytes."""
    return text.encode("utf-8", "surrogatepass")


def _framed(part: bytes) -> bytes:
    """`part` with its length: two parts that follow one another are not two others."""
    return b"%d:" % len(part) + part


def _read(file: Path) -> str | None:
    """The answer in `file`; None if there is none, not as it was written, or by another user."""
    try:
        # a pipe would be waited for
        if not stat.S_ISREG(os.lstat(file).st_mode) or foreign(file):
            return None
        seal, _, answer = file.read_bytes().partition(b"\n")
        if seal.decode() != _hash(file.name.encode(), answer):
            return None
        os.utime(file)
        return answer.decode("utf-8", "surrogatepass")
    except (OSError, ValueError):
        return None


def _write(file: Path, answer: str) -> None:
    """Put `answer` into `file`, at once for everybody who looks."""
    content = _encoded(answer)
    beside = file.with_name(f".{file.name[:12]}-{os.getpid()}-{time.monotonic_ns()}")
    try:
        # whatever the umask leaves to others
        beside.touch(0o600, exist_ok=False)
        beside.write_bytes(_hash(file.name.encode(), content).encode() + b"\n" + content)
        os.replace(beside, file)
    finally:
        with contextlib.suppress(OSError):
            beside.unlink()
