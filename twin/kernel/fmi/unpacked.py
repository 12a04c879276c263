"""Cache of unpacked FMUs, one folder per content, verified against the archive at every use; compilation from source.

A folder contains the files of the archive in `fmu`, and in `seal.json` their size, times and inode at the last
verification. Files whose stamp is unchanged are not read again.
"""

import contextlib
import importlib.util
import json
import math
import os
import posixpath
import re
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import time
import zipfile
from collections.abc import Collection, Sequence
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from twin.kernel.archive import entry_path
from twin.kernel.cache_folder import (
    CACHE_REMEDY,
    PRIVATE_MODE,
    cache_folder,
    discard_foreign,
    evict,
    lock_against_eviction,
    remove,
)
from twin.kernel.errors import InputRefused, translate_disk_errors
from twin.kernel.fmi import COMPILED_FOLDER

COMPILER_FILE = "compiler.json"
ZIG_PACKAGE = "ziglang"
BINARY_PARTS = 3
"""Number of parts in the path of a library: binaries/linux64/name.so."""
COMPILE_TIMEOUT = 300.0
"""Compile timeout (s). FMUs with thousands of lines need about 10 s."""
MAX_COMPILER_MEMORY, MAX_COMPILER_FILE = 4 << 30, 1 << 30
"""Maximum memory of a compiler process and maximum size of a file it writes (bytes); sources of 10 MB need a tenth."""
C_SUFFIXES = (".c",)
CPP_SUFFIXES = (".cpp", ".cc", ".cxx")
MACRO_PATTERN = re.compile(r"[A-Za-z_]\w*(\([\w ,.]*\))?", re.ASCII)
"""Valid macro names (C11, 6.10.3). gcc passes the name to cc1 as an argument, where `@file` would read options."""
MAX_OUTPUT_READ, MAX_OUTPUT_SHOWN = 1 << 20, 300
"""Maximum compiler output that is read (bytes), and shown in a message (characters)."""
COMPILER_VARIABLES = ("DEPENDENCIES_OUTPUT", "SUNPRO_DEPENDENCIES", "GCC_COMPARE_DEBUG", "CCC_OVERRIDE_OPTIONS")
"""Environment variables that make a compiler write additional files or change its options."""

# limits per process: no core dump, processor time (s), data (kB), file size (512 bytes); lower existing limits are kept
_LIMIT_SCRIPT = "for o in '-c 0' '-t {time}' '-d {memory}' '-f {written}'; do ulimit $o 2>/dev/null; done; exec \"$@\""

# sources for static linking define a prefix, which the header of FMI 2.0 cannot override
_WITHOUT_PREFIX = """#undef FMI2_FUNCTION_PREFIX
#include_next <fmi2Functions.h>
"""
UNPACKED_FOLDER = "unpacked"
CONTENT_FOLDER, SEAL_FILE = "fmu", "seal.json"
MAX_UNPACKED_FMUS = 50
"""Maximum number of folders to keep; folders in use are never removed."""
_CHUNK_SIZE = 1 << 20
Stamp = list[int]


class CompiledLibrary(NamedTuple):
    """An FMU's library compiled on this machine, and the compiler with its version."""

    library: Path
    compiler: str


def compiled_library(digest: str, binary: str) -> CompiledLibrary | None:
    """Return the library `binary` (path in the archive) compiled for the FMU with SHA-256 `digest`; None if missing."""
    folder = _compiled_folder(digest)
    library = folder / binary
    try:
        facts = json.loads((folder / COMPILER_FILE).read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    return CompiledLibrary(library, str(facts.get("compiler"))) if library.is_file() else None


def _compiled_folder(digest: str) -> Path:
    """Return the folder of the library compiled for the FMU with SHA-256 `digest`; files of other users are removed."""
    folder = cache_folder(COMPILED_FOLDER) / digest
    with translate_disk_errors(folder, "cannot be removed", InputRefused, CACHE_REMEDY):
        discard_foreign(folder)
    return folder


def source_sets(model: Any, identifier: str) -> list[Any]:
    """Return the source file sets with build instructions of an FMU (FMPy's); empty without declarations."""
    return [
        one
        for configuration in model.buildConfigurations
        if configuration.modelIdentifier in (None, identifier)
        for one in configuration.sourceFileSets
        if one.sourceFiles
    ]


def has_sources(names: Collection[str], sets: Sequence[Any]) -> bool:
    """Whether an FMU has source sets, and its archive contains all their files."""
    return bool(sets) and all(
        posixpath.normpath(f"sources/{source}") in names for one in sets for source in one.sourceFiles
    )


def install_compiled(digest: str, content: Path) -> None:
    """Copy the FMU's (SHA-256 `digest`) compiled library to its unpacked files in `content`; OSError if that fails."""
    folder = _compiled_folder(digest)
    for library in folder.glob("binaries/*/*"):
        target = content / library.relative_to(folder)
        if not target.is_file() or target.stat().st_mtime_ns != library.stat().st_mtime_ns:
            target.parent.mkdir(parents=True, exist_ok=True)
            replacement = target.with_name(f".{os.getpid()}-{target.name}")
            shutil.copy2(library, replacement)
            os.replace(replacement, target)


def compile_sources(file: Path, digest: str, model: Any, binary: str) -> CompiledLibrary:
    """Compile the sources of an FMU for this platform, unless they are compiled already.

    `model` is FMPy's description with build configurations, `binary` the library's path in the archive.
    """
    done = compiled_library(digest, binary)
    if done is not None:
        return done
    # a deeper path would leave the build folder
    if len(PurePosixPath(binary).parts) != BINARY_PARTS:
        identifier = binary.split("/", BINARY_PARTS - 1)[-1]
        raise InputRefused(f"{file}: modelIdentifier leads to '{identifier}'; expected a name. Do not trust this file")
    sets = source_sets(model, PurePosixPath(binary).stem)
    if not sets:
        raise InputRefused(f"{file}: holds no sources with build instructions; export it for this platform")
    home = cache_folder(COMPILED_FOLDER)
    with (
        translate_disk_errors(file, f"cannot be compiled in {home}", InputRefused, CACHE_REMEDY),
        tempfile.TemporaryDirectory(dir=home, prefix=f".{digest[:12]}-") as scratch,
    ):
        made = _build_library(file, sets, Path(scratch).absolute(), binary)
        with (Path(scratch) / "kept" / COMPILER_FILE).open("w") as facts:
            json.dump({"compiler": made.compiler}, facts)
        try:
            os.rename(Path(scratch) / "kept", home / digest)
        # another process has compiled it in the meantime
        except OSError:
            if compiled_library(digest, binary) is None:
                raise
    return CompiledLibrary(home / digest / binary, made.compiler)


def _build_library(file: Path, sets: Sequence[Any], scratch: Path, binary: str) -> CompiledLibrary:
    with zipfile.ZipFile(file) as archive:
        for entry in archive.infolist():
            name = entry_path(entry)
            if name.startswith("sources/") and not name.endswith("/"):
                target = scratch / name
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(archive.read(entry))
    library = scratch / "kept" / binary
    (scratch / "kept").mkdir(PRIVATE_MODE)
    library.parent.mkdir(parents=True)
    headers = scratch / "headers"
    headers.mkdir()
    (headers / "fmi2Functions.h").write_text(_WITHOUT_PREFIX)
    # gcc uses a precompiled header, an image of its memory, only for the first header included: include an empty one
    # first
    first = headers / "first.h"
    first.touch()
    includes = ["-include", str(first), f"-I{headers}", f"-I{scratch / 'sources'}", f"-I{fmi_headers()}"]
    reason = (
        f"{file}: its sources do not compile",
        f"{file}: its sources still compile after {COMPILE_TIMEOUT:g} s; build it elsewhere",
    )
    end = time.monotonic() + COMPILE_TIMEOUT
    objects: list[str] = []
    plus = False
    for number, one in enumerate(sets):
        options = [_macro_option(file, d.name, d.value) for d in one.preprocessorDefinitions]
        options += [f"-I{_source_path(file, scratch, name)}" for name in one.includeDirectories]
        for source in one.sourceFiles:
            target = scratch / f"{number}_{len(objects)}.o"
            where = _source_path(file, scratch, source)
            is_plus = where.suffix.lower() in CPP_SUFFIXES
            if not is_plus and where.suffix.lower() not in C_SUFFIXES:
                known = ", ".join((*C_SUFFIXES, *CPP_SUFFIXES))
                raise InputRefused(f"{file}: its source '{source}' is neither C nor C++ ({known}); build it elsewhere")
            plus |= is_plus
            call_compiler(
                [*compiler_command(file, is_plus), "-c", "-O2", "-fPIC", "-w", "-DFMI3_OVERRIDE_FUNCTION_PREFIX",
                 *options, *includes, str(where), "-o", str(target)], *reason, scratch, end,
            )  # fmt: skip
            objects.append(str(target))
    linker = compiler_command(file, plus)
    # objects may carry LTO options that a linker plugin would execute
    call_compiler([*linker, "-shared", "-fno-lto", *objects, "-lm", "-o", str(library)], *reason, scratch, end)
    version = call_compiler([*linker, "--version"], *reason, scratch, end)
    return CompiledLibrary(library, (version.splitlines() or [linker[0]])[0].strip())


def _macro_option(file: Path, name: str | None, value: str | None) -> str:
    if not MACRO_PATTERN.fullmatch(name or "") or not (value or "").isprintable():
        text = f"{name}={value}" if value else name
        raise InputRefused(
            f"{file}: its sources ask for the macro '{text}'; expected an identifier, or one with a list of arguments, "
            "and a value on one line. Do not trust this file"
        )
    return f"-D{name}" + (f"={value}" if value else "")


def _source_path(file: Path, scratch: Path, name: str | None) -> Path:
    """Return the path of a source file or folder that the FMU names, which has to be inside its sources."""
    home = (scratch / "sources").resolve()
    path = (home / (name or "?")).resolve()
    if not path.is_relative_to(home) or not path.exists():
        raise InputRefused(f"{file}: its sources hold no '{name}', which it lists as a source; export it again")
    return path


def compiler_command(wanted: Path, plus: bool = False) -> list[str]:
    """Return the command of the platform's C (or C++, if `plus`) compiler, else of ziglang's, to build `wanted`."""
    for name in ("c++", "g++", "clang++") if plus else ("cc", "gcc", "clang"):
        found = shutil.which(name)
        if found:
            # absolute, as it runs in another folder
            return [os.path.abspath(found)]
    if importlib.util.find_spec(ZIG_PACKAGE) is not None:
        return [*zig_command(), "c++" if plus else "cc"]
    raise InputRefused(f"{wanted}: no C compiler found; install one (cc), or pip install {ZIG_PACKAGE}")


def zig_command() -> list[str]:
    # -P: do not import modules from the folder in which it runs
    return [sys.executable, "-P", "-m", ZIG_PACKAGE]


def fmi_headers() -> Path:
    """Return the folder of FMI's C headers, which FMPy contains."""
    # find_spec avoids importing FMPy, which takes longer than most commands
    fmpy = importlib.util.find_spec("fmpy")
    assert fmpy is not None and fmpy.origin is not None, "a dependency of this package"
    return Path(fmpy.origin).absolute().parent / "c-code"


def call_compiler(command: Sequence[str], refused: str, late: str, folder: Path, end: float | None = None) -> str:
    """Run a compiler in `folder` with limits of time, memory and file size; return the beginning of its output.

    All its processes are killed afterwards. Error messages begin with `refused`, or are `late` after the deadline `end`
    (s, `time.monotonic`; None for `COMPILE_TIMEOUT` from now).
    """
    remaining = COMPILE_TIMEOUT if end is None else max(end - time.monotonic(), 0.0)
    limits = _LIMIT_SCRIPT.format(
        time=math.ceil(COMPILE_TIMEOUT), memory=MAX_COMPILER_MEMORY >> 10, written=MAX_COMPILER_FILE >> 9
    )
    environment = {name: value for name, value in os.environ.items() if name not in COMPILER_VARIABLES}
    # output goes to a file, as it may be endless
    with tempfile.TemporaryFile(dir=folder) as log:
        process = subprocess.Popen(
            ["/bin/sh", "-c", limits, "sh", *command],
            cwd=folder,
            env={**environment, "TMPDIR": str(folder)},
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            status = process.wait(remaining)
        except subprocess.TimeoutExpired:
            raise InputRefused(late) from None
        finally:
            # kill its process group, also after Ctrl-C; the PID is not reused before the wait below
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        log.seek(0)
        text = log.read(MAX_OUTPUT_READ).decode(errors="replace")
    if status:
        lines = text.splitlines()
        errors = [line for line in lines if "error" in line or "undefined" in line]
        reason = (errors or lines or ["without a word"])[0][:MAX_OUTPUT_SHOWN]
        raise InputRefused(f"{refused} with {Path(command[0]).name}: {reason}")
    return text


class CacheInfo(NamedTuple):
    """Contents of the FMU cache: number of FMUs, total size (bytes), files modified since they were verified."""

    folder: Path
    drives: int
    size: int
    changed: tuple[Path, ...]


def cache_info() -> CacheInfo:
    """Summarise the cache of unpacked FMUs without repairing it."""
    home = cache_folder(UNPACKED_FOLDER)
    folders = [path for path in home.iterdir() if not path.name.startswith(".")]
    size, changed = 0, []
    for folder in folders:
        for name, stamp in sealed_stamps(folder).items():
            path = f"{folder}/{CONTENT_FOLDER}/{name}"
            found = stamp_of(path)
            size += found[0] if found else 0
            if found != stamp:
                changed.append(Path(path))
    return CacheInfo(home, len(folders), size, tuple(changed))


def sealed_stamps(folder: Path) -> dict[str, Stamp]:
    """Return the stamps (size, times, inode) of a cache folder's files at the last verification; empty if damaged."""
    try:
        known = json.loads((folder / SEAL_FILE).read_bytes())
    except (OSError, ValueError, RecursionError):
        return {}
    return known if isinstance(known, dict) else {}


def stamp_of(path: str) -> Stamp | None:
    """Return the file's size, times (a write changes ctime, which cannot be set back) and inode; None if missing."""
    try:
        found = os.lstat(path)
    # ValueError: a damaged seal may contain any name
    except (OSError, ValueError):
        return None
    if not stat.S_ISREG(found.st_mode):
        return None
    return [found.st_size, found.st_mtime_ns, found.st_ctime_ns, found.st_ino]


def unpacked(file: Path, digest: str) -> Path:
    """Unpack an FMU with the SHA-256 `digest` to its cache folder, or verify and repair that; return its folder.

    The FMU has been checked by `archive.entries`. The folder is shared by all runs and created atomically. Changed or
    missing files are extracted again, with a warning on stderr. InputRefused: it cannot be written.
    """
    home = cache_folder(UNPACKED_FOLDER)
    folder = home / digest
    with translate_disk_errors(file, f"cannot be unpacked to {home}", InputRefused, CACHE_REMEDY):
        discard_foreign(folder)
        while not lock_against_eviction(folder):
            _unpack_archive(file, digest, folder)
        try:
            mended = _repair_folder(file, digest, folder)
        except OSError:
            # e.g. a folder in the place of a file; libraries already loaded stay loaded
            remove(folder)
            _unpack_archive(file, digest, folder)
            lock_against_eviction(folder)
            mended = ["all"]
        install_compiled(digest, folder / CONTENT_FOLDER)
    if mended:
        listed = ", ".join(mended[:3]) + (f" and {len(mended) - 3} more" if len(mended) > 3 else "")
        warning = f"twin: {file.name}: unpacked files had been changed ({listed}): taken from the FMU again"
        print(warning, file=sys.stderr)
    return folder / CONTENT_FOLDER


def _unpack_archive(file: Path, digest: str, folder: Path) -> None:
    """Unpack the FMU archive `file` to `folder`, unless another process does so first."""
    if folder.exists() and not folder.is_dir():
        remove(folder)
    scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name[:12]}-", dir=folder.parent))
    try:
        _repair_folder(file, digest, scratch)
        scratch.rename(folder)
    except OSError:
        if not folder.is_dir():
            raise
    finally:
        shutil.rmtree(scratch, ignore_errors=True)
    evict(folder.parent, MAX_UNPACKED_FMUS)


def _repair_folder(file: Path, digest: str, folder: Path) -> list[str]:
    """Replace files in an FMU's cache folder that differ from the archive `file`; return their names."""
    content, sealed = folder / CONTENT_FOLDER, sealed_stamps(folder)
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
                _extract_entry(archive, entries[name], content)
                found[name] = stamp_of(f"{content}/{name}")
                wrong.append(name)
    with tempfile.NamedTemporaryFile("w", dir=folder, delete=False) as replacement:
        json.dump(found, replacement)
    os.replace(replacement.name, folder / SEAL_FILE)
    return wrong


@lru_cache(MAX_UNPACKED_FMUS)
def _entries(file: Path, digest: str) -> dict[str, zipfile.ZipInfo]:
    """Return the entries of the archive `file` by path; `digest` identifies its content for the cache."""
    with zipfile.ZipFile(file) as archive:
        # the last of several entries with the same name is the valid one
        return {entry_path(info): info for info in archive.infolist()}


def _is_same(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, path: Path) -> bool:
    try:
        with archive.open(entry) as wanted, path.open("rb") as there:
            while chunk := wanted.read(_CHUNK_SIZE):
                if chunk != there.read(len(chunk)):
                    return False
            return not there.read(1)
    except PermissionError:
        return False


def _extract_entry(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, content: Path) -> None:
    """Extract an archive entry to `content` by atomic replacement, so that processes keep a loaded old file."""
    target = content / entry_path(entry)
    if target.is_dir() and not target.is_symlink():
        shutil.rmtree(target)
    target.parent.mkdir(parents=True, exist_ok=True)
    handle, beside = tempfile.mkstemp(dir=target.parent)
    try:
        with archive.open(entry) as packed, os.fdopen(handle, "wb") as stream:
            shutil.copyfileobj(packed, stream, _CHUNK_SIZE)
        os.replace(beside, target)
    finally:
        with contextlib.suppress(FileNotFoundError):
            os.unlink(beside)
