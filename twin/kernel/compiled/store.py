"""Object files kept between processes, one for each root function, loaded without numba.

A root is a function that C or Python calls. Its file contains all functions that it calls, and imports only
mathematics. The file name is derived from the code that the root reaches (without comments and docstrings), its
closure, its types, the version of numba and the processor form, so that code of an older source is never loaded. A
hash at the end of a file detects damage; a damaged file is deleted and compiled again. Protection against malicious
files: folder and files belong to the user alone (`twin.kernel.cache_folder`), or came with the package in a wheel.
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
    # Windows has no fcntl; two processes may compile the same file there
    fcntl = None  # type: ignore[assignment]

FOLDER_VARIABLE = "NUMBA_CACHE_DIR"
"""Environment variable that selects the folder of compiled code."""
MAX_FILES = 1000
"""Maximum number of stored files: seven versions of all functions, two files each."""
OBJECT_SUFFIX = ".o"
SEAL_SIZE = 16
"""Size of the hash at the end of a file (bytes)."""
PACKAGED_OBJECTS = Path(__file__).with_name("objects")
"""Folder of the object files in a wheel; searched first and never written."""
DIGESTS_FILE = "sources.json"
"""File of parsed source files, see `twin.kernel.compiled.source`."""
MAX_DIGESTS = 1000
"""Maximum number of source files in DIGESTS_FILE: seven versions of each."""
_FILE_PATTERN = re.compile(r".+\.(o|ll)")
_refusal: list[str] = []
_reported: set[Path] = set()


class UnnamedFunction(Exception):
    """Error that a function's code has no unique name, so that its machine code cannot be stored."""


def name_of(function: Any, made_for: str) -> str:
    """Derive the name of a function's object file from its code and `made_for`: types, compiler, processor.

    UnnamedFunction: its source is in no file, or its closure contains an object without a known value.
    """
    modules: set[str] = set()
    variant = digest_of(f"{_identity(function, modules)}\0{made_for}".encode())
    return f"{function.__module__}.{function.__name__}-{variant}-{source_digest(*modules)}"


def store_file(file: str, content: bytes) -> None:
    """Write a file, sealed by a hash, to the folder of object files; silently skipped if writing fails."""
    scratch = object_folder() / f".{file}-{os.getpid()}"
    # the code also runs unstored, e.g. if the disk is full or the folder was removed
    with contextlib.suppress(OSError):
        # mode 0600 regardless of the umask
        with open(scratch, "wb", opener=lambda path, flags: os.open(path, flags, 0o600)) as written:
            written.write(seal(file, content))
        scratch.replace(object_folder() / file)
        evict(object_folder(), MAX_FILES, _FILE_PATTERN)


def seal(file: str, content: bytes) -> bytes:
    """Append to a file's content a hash over its name and content, so that a damaged or renamed file is recognised."""
    return content + hashlib.blake2b(file.encode() + b"\0" + content, digest_size=SEAL_SIZE).digest()


def stored_code(file: str) -> bytes:
    """Read a compiled function's file from the package or the store; empty if missing or damaged, and then deleted."""
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
    """Hold a lock during the block that prevents other processes from compiling the same function."""
    try:
        lock = open(object_folder() / f".{name}.lock", "w")  # noqa: SIM115, closed by the with statement below
    except OSError:
        # nothing can be stored, so no other process would wait for this one
        yield
        return
    with lock:
        if fcntl is not None:
            with contextlib.suppress(OSError):
                fcntl.flock(lock, fcntl.LOCK_EX)
        yield


@cache
def object_folder() -> Path:
    """Return the folder of object files: in the package, in the user's cache, or temporary; the first private one.

    Child processes share a temporary folder.
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
        import atexit
        import shutil
        import tempfile

        os.environ[FOLDER_VARIABLE] = tempfile.mkdtemp(prefix="twin-native-")
        atexit.register(shutil.rmtree, os.environ[FOLDER_VARIABLE], ignore_errors=True)
        return private_folder(Path(os.environ[FOLDER_VARIABLE], "objects"))


def refusal() -> str:
    """Return the error message if no private folder for compiled code was found; "" otherwise."""
    object_folder()
    return "".join(_refusal)


def object_files(place: Path | None = None) -> list[Path]:
    """List the object files of compiled functions in `place`; None for the store, with files of all source versions."""
    return sorted((place or object_folder()).glob(f"[!.]*{OBJECT_SUFFIX}"))


def damaged_files(files: Iterable[Path]) -> list[Path]:
    """Return the elements of `files` whose content does not match the hash stored in them."""

    def is_damaged(path: Path) -> bool:
        try:
            return not _unseal(path)
        except OSError as problem:
            # another process may have deleted it
            return not isinstance(problem, FileNotFoundError)

    return [path for path in files if is_damaged(path)]


def source_digest(*modules: str) -> str:
    """Compute the digest of the source code of `modules` and all that they import, except installed packages."""
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
    with contextlib.suppress(OSError, ValueError, TypeError, AttributeError):
        path = object_folder() / DIGESTS_FILE
        discard_foreign(path)
        return {
            whole: SourceFile(digest, tuple((origin, tuple(names)) for origin, names in imports), tuple(functions))
            for whole, (digest, imports, functions) in json.loads(_unseal(path)).items()
        }
    return {}


def _store_digests(sources: Sources) -> None:
    """Store the cache of source-file digests, merged with the entries that other processes have stored meanwhile."""
    both = _read_digests() | sources.known
    store_file(DIGESTS_FILE, json.dumps(dict([*both.items()][-MAX_DIGESTS:])).encode())


def _identity(value: Any, modules: set[str]) -> str:
    """Return a text that identifies a function or a value in its closure; add all functions' modules to `modules`."""
    import numpy as np

    # unwrap a `Function` of this package or a numba dispatcher
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
    """Return the content of a sealed file without its hash; empty if the hash does not match."""
    content = path.read_bytes()
    return content[:-SEAL_SIZE] if content == seal(path.name, content[:-SEAL_SIZE]) else b""
