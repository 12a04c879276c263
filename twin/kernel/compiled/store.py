"""Machine code kept between processes: an object file for each root, which is loaded without numba.

A root is a function that C or Python calls; its file holds all that it calls, and asks for nothing but mathematics. The
file is named after the code that the root reaches, without its text, what it was closed over, its types, numba and the
form of the processor, so that code of an older source is never found. A hash at its end finds accidents: what was
damaged is thrown away and compiled again. Against malice stands that the folder and each file are the user's alone, see
`twin.kernel.cache_folder`; or that they came with the package, where a wheel has brought them.
"""

import contextlib
import hashlib
import json
import os
import re
import sys
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

from twin.kernel.cache_folder import cache_folder, discard_foreign, evict, private_folder, remove
from twin.kernel.compiled.source import PACKAGE_FOLDER, SourceFile, Sources, digest_of, source_file
from twin.kernel.errors import InputRefused

try:
    import fcntl
except ImportError:
    # Windows, where two processes may make the same file
    fcntl = None  # type: ignore[assignment]

FOLDER_VARIABLE = "NUMBA_CACHE_DIR"
"""Names a folder of the user's own choice."""
MAX_FILES = 1000
"""Files that are kept: seven sources of all there is, two files each."""
OBJECT_SUFFIX = ".o"
SEAL_SIZE = 16
"""Bytes of the hash at the end of a file."""
PACKAGED_OBJECTS = Path(__file__).with_name("objects")
"""Where a wheel has object files; they are looked at first and never written."""
DIGESTS_FILE = "sources.json"
"""File of parsed source files, see `twin.kernel.compiled.source`."""
MAX_DIGESTS = 1000
"""Maximum number of source files in it: seven versions of each."""
_FILE_PATTERN = re.compile(r".+\.(o|ll)")
_refusal: list[str] = []
_reported: set[Path] = set()


class UnnamedFunction(Exception):
    """A function whose code has no unique name."""


def name_of(function: Any, made_for: str) -> str:
    """Of the object file of a function.

    Args:
        function: its source.
        made_for: what tells its types, the compiler and the processor.

    Raises:
        Unnamed: its source is in no file, or it is closed over something without a known value.
    """
    modules: set[str] = set()
    variant = digest_of(f"{_identity(function, modules)}\0{made_for}".encode())
    return f"{function.__module__}.{function.__name__}-{variant}-{source_digest(*modules)}"


def store_file(file: str, content: bytes) -> None:
    """Put a file beside the object files, if that is possible."""
    aside = object_folder() / f".{file}-{os.getpid()}"
    # a full disk, a folder that is gone: the code runs all the same
    with contextlib.suppress(OSError):
        # whatever the umask leaves to others
        with open(aside, "wb", opener=lambda path, flags: os.open(path, flags, 0o600)) as written:
            written.write(seal(file, content))
        aside.replace(object_folder() / file)
        evict(object_folder(), MAX_FILES, _FILE_PATTERN)


def seal(file: str, content: bytes) -> bytes:
    """The bytes of a file of that name; one that was renamed is none of ours."""
    return content + hashlib.blake2b(file.encode() + b"\0" + content, digest_size=SEAL_SIZE).digest()


def stored_code(file: str) -> bytes:
    """What came with the package or was kept under that name; nothing if it is not there, or not as it was written."""
    with contextlib.suppress(OSError):
        if content := _unseal(PACKAGED_OBJECTS / file):
            return content
    path = object_folder() / file
    try:
        discard_foreign(path)
        content = _unseal(path)
        os.utime(path)
    except FileNotFoundError:
        return b""
    except OSError:
        content = b""
    if not content:
        with contextlib.suppress(OSError):
            remove(path)
        if object_folder() not in _reported:
            _reported.add(object_folder())
            print(f"twin: compiled code in {object_folder()}/ was damaged: compiled again", file=sys.stderr)
    return content


@contextlib.contextmanager
def object_lock(name: str) -> Iterator[None]:
    """No other process makes the object file of that name meanwhile."""
    try:
        lock = open(object_folder() / f".{name}.lock", "w")  # noqa: SIM115, its end is below
    except OSError:
        # nothing can be stored, so no process can wait for it
        yield
        return
    with lock:
        if fcntl is not None:
            with contextlib.suppress(OSError):
                fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@cache
def object_folder() -> Path:
    """Where object files are: beside the package, or in the user's cache folder where that is not the user's alone.

    Where neither is, nothing is kept beyond this process and those that it starts.
    """
    given = os.environ.get(FOLDER_VARIABLE)
    try:
        if given:
            return private_folder(Path(given, "objects").absolute())
        try:
            return private_folder(PACKAGE_FOLDER / "__pycache__" / "native")
        except InputRefused:
            return cache_folder("native")
    except InputRefused as refused:
        _refusal.append(str(refused))
        os.environ[FOLDER_VARIABLE] = _temporary_folder()
        return private_folder(Path(os.environ[FOLDER_VARIABLE], "objects"))


def refusal() -> str:
    """Why nothing that is compiled is kept, as a sentence; "" if it is."""
    object_folder()
    return "".join(_refusal)


def object_files(place: Path | None = None) -> list[Path]:
    """Those that are kept, of all sources; or those of another place, `PACKAGED_OBJECTS` say."""
    return sorted((place or object_folder()).glob(f"[!.]*{OBJECT_SUFFIX}"))


def object_count() -> int:
    """How many object files are kept; what a run needs beyond them is compiled when it is needed."""
    return len(object_files())


def damaged_files(files: Iterable[Path]) -> list[Path]:
    """Those of `files` that are not as they were written."""

    def is_damaged(path: Path) -> bool:
        try:
            return not _unseal(path)
        except OSError as problem:
            # another process may have cleared it
            return not isinstance(problem, FileNotFoundError)

    return [path for path in files if is_damaged(path)]


def source_digest(*modules: str) -> str:
    """Return the digest of the code of `modules` and all that they import, but for installed packages."""
    sources = _sources()
    before = sources.parsed
    found = sources.digest(*modules)
    if sources.parsed > before:
        _store_digests(sources)
    return found


@cache
def _sources() -> Sources:
    return Sources(_read_digests())


def _read_digests() -> dict[str, SourceFile]:
    """What earlier processes have found in source files; empty if nothing is kept, or it is damaged."""
    with contextlib.suppress(OSError, ValueError, TypeError, AttributeError):
        path = object_folder() / DIGESTS_FILE
        discard_foreign(path)
        return {
            whole: SourceFile(digest, tuple((origin, tuple(names)) for origin, names in imports), tuple(functions))
            for whole, (digest, imports, functions) in json.loads(_unseal(path)).items()
        }
    return {}


def _store_digests(sources: Sources) -> None:
    """Keep them beside the object files, with those that another process has kept meanwhile."""
    both = _read_digests() | sources.known
    store_file(DIGESTS_FILE, json.dumps(dict([*both.items()][-MAX_DIGESTS:])).encode())


def _identity(value: Any, modules: set[str]) -> str:
    """What tells `value`, a function or what it is closed over, from others within their source.

    Args:
        value: it.
        modules: those of functions in it are added.

    Raises:
        Unnamed: nothing does.
    """
    import numpy as np

    # ours is a name for a function, and so is numba's
    value = getattr(value, "__wrapped__", getattr(value, "py_func", value))
    if value is None or isinstance(value, (bool, int, float, str)):
        return repr(value)
    if isinstance(value, np.dtype):
        return f"{value.descr} {value.itemsize}"
    if isinstance(value, (tuple, list)):
        return f"({', '.join(_identity(each, modules) for each in value)})"
    if callable(value) and hasattr(value, "__code__") and source_file(value.__module__):
        modules.add(value.__module__)
        closed = [cell.cell_contents for cell in value.__closure__ or ()]
        return f"{value.__module__}.{value.__qualname__}:{_sources().place(value)}{_identity(closed, modules)}"
    raise UnnamedFunction


def _unseal(path: Path) -> bytes:
    """What was sealed in a file; nothing if it is not as it was written."""
    content = path.read_bytes()
    return content[:-SEAL_SIZE] if content == seal(path.name, content[:-SEAL_SIZE]) else b""


def _temporary_folder() -> str:
    """A folder that goes with this process."""
    import atexit
    import shutil
    import tempfile

    passing = tempfile.mkdtemp(prefix="twin-native-")
    atexit.register(shutil.rmtree, passing, ignore_errors=True)
    return passing
