"""The folder of unpacked FMUs: one per content, verified against the archive at every use.

A folder has the files of the archive in `fmu`, and in `seal.json` how they were found when they were last compared:
size, times, inode. What is still found so is not read again."""

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
"""Of the place of a library: binaries/linux64/name.so."""
COMPILE_TIMEOUT = 300.0
"""s. Honest sources of thousands of lines take some ten."""
MAX_COMPILER_MEMORY, MAX_COMPILER_FILE = 4 << 30, 1 << 30
"""Bytes, of a process and of a file. Honest sources of 10 MB need a tenth of either."""
C_SUFFIXES = (".c",)
CPP_SUFFIXES = (".cpp", ".cc", ".cxx")
MACRO_PATTERN = re.compile(r"[A-Za-z_]\w*(\([\w ,.]*\))?", re.ASCII)
"""What a macro may be called (C11, 6.10.3). gcc hands the name to cc1 as a word, and `@file` is a file of options."""
MAX_OUTPUT_READ, MAX_OUTPUT_SHOWN = 1 << 20, 300
"""Of what a compiler says: bytes that are looked at, and characters that are shown."""
COMPILER_VARIABLES = ("DEPENDENCIES_OUTPUT", "SUNPRO_DEPENDENCIES", "GCC_COMPARE_DEBUG", "CCC_OVERRIDE_OPTIONS")
"""Environment variables by which a compiler writes other files, or takes other options, than it is asked to."""

# of each process: no core, time on a processor (s), data (kB), what it writes (512 bytes); a lower one is left as it is
_LIMIT_SCRIPT = "for o in '-c 0' '-t {time}' '-d {memory}' '-f {written}'; do ulimit $o 2>/dev/null; done; exec \"$@\""

# FMI 2.0's header has no way to leave out the prefix that sources for static linking define
_WITHOUT_PREFIX = """#undef FMI2_FUNCTION_PREFIX
#include_next <fmi2Functions.h>
"""
UNPACKED_FOLDER = "unpacked"
CONTENT_FOLDER, SEAL_FILE = "fmu", "seal.json"
MAX_UNPACKED_FMUS = 50
"""Maximum number of folders to keep; folders in use are never removed."""
_CHUNK_SIZE = 1 << 20


class CompiledLibrary(NamedTuple):
    """A library that was compiled here.

    Attributes:
        library: where it is kept.
        compiler: what made it, with its version.
    """

    library: Path
    compiler: str


def compiled_library(digest: str, binary: str) -> CompiledLibrary | None:
    """The library of the FMU with SHA-256 `digest`, if it was compiled for this platform.

    Args:
        digest: of the archive.
        binary: its place in the archive, as it would be.
    """
    folder = _compiled_folder(digest)
    library = folder / binary
    try:
        facts = json.loads((folder / COMPILER_FILE).read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    return CompiledLibrary(library, str(facts.get("compiler"))) if library.is_file() else None


def _compiled_folder(digest: str) -> Path:
    """The folder of what was compiled of the FMU with SHA-256 `digest`; what lies there is the user's own.

    Raises:
        InputRefused: see `cache_folder`.
    """
    folder = cache_folder(COMPILED_FOLDER) / digest
    with translate_disk_errors(folder, "cannot be removed", InputRefused, CACHE_REMEDY):
        discard_foreign(folder)
    return folder


def source_sets(model: Any, identifier: str) -> list[Any]:
    """The sources of an FMU and how they are compiled, as FMPy reads that; none, if it does not say."""
    return [
        one
        for configuration in model.buildConfigurations
        if configuration.modelIdentifier in (None, identifier)
        for one in configuration.sourceFileSets
        if one.sourceFiles
    ]


def has_sources(names: Collection[str], sets: Sequence[Any]) -> bool:
    """Whether an archive with entries `names` holds all that these source sets name, and they name something."""
    return bool(sets) and all(
        posixpath.normpath(f"sources/{source}") in names for one in sets for source in one.sourceFiles
    )


def install_compiled(digest: str, content: Path) -> None:
    """Put what was compiled of the FMU with that SHA-256 into the folder `content` of its unpacked files.

    Raises:
        OSError: it cannot be written there.
    """
    folder = _compiled_folder(digest)
    for library in folder.glob("binaries/*/*"):
        target = content / library.relative_to(folder)
        if not target.is_file() or target.stat().st_mtime_ns != library.stat().st_mtime_ns:
            target.parent.mkdir(parents=True, exist_ok=True)
            beside = target.with_name(f".{os.getpid()}-{target.name}")
            shutil.copy2(library, beside)
            os.replace(beside, target)


def compile_sources(file: Path, digest: str, model: Any, binary: str) -> CompiledLibrary:
    """Compile the sources of `file` for this platform, unless that was done before.

    Args:
        file: the FMU, its archive checked.
        digest: its SHA-256.
        model: its description by FMPy, with the build configurations.
        binary: where its library would be in the archive.

    Raises:
        InputRefused: it has no sources that say how to be compiled, there is no compiler, or the compiler refuses.
    """
    done = compiled_library(digest, binary)
    if done is not None:
        return done
    # below the folder in which it is built, too
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
        # somebody else was faster
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
    # gcc loads a header that was compiled before, a picture of its own memory, in place of the first that is included
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
    # objects may claim to be unfinished and bring options with which a linker's plugin finishes them
    call_compiler([*linker, "-shared", "-fno-lto", *objects, "-lm", "-o", str(library)], *reason, scratch, end)
    version = call_compiler([*linker, "--version"], *reason, scratch, end)
    return CompiledLibrary(library, (version.splitlines() or [linker[0]])[0].strip())


def _macro_option(file: Path, name: str | None, value: str | None) -> str:
    """The option that defines a macro."""
    if not MACRO_PATTERN.fullmatch(name or "") or not (value or "").isprintable():
        text = f"{name}={value}" if value else name
        raise InputRefused(
            f"{file}: its sources ask for the macro '{text}'; expected an identifier, or one with a list of arguments, "
            "and a value on one line. Do not trust this file"
        )
    return f"-D{name}" + (f"={value}" if value else "")


def _source_path(file: Path, scratch: Path, name: str | None) -> Path:
    """The place of a source or folder that the FMU names, which is below its sources."""
    home = (scratch / "sources").resolve()
    path = (home / (name or "?")).resolve()
    if not path.is_relative_to(home) or not path.exists():
        raise InputRefused(f"{file}: its sources hold no '{name}', which it says to compile; export it again")
    return path


def compiler_command(wanted: Path, plus: bool = False) -> list[str]:
    """The platform's compiler, else that of ziglang.

    Args:
        wanted: what is to be built, for the sentence.
        plus: whether it has C++ in it.

    Raises:
        InputRefused: there is none.
    """
    for name in ("c++", "g++", "clang++") if plus else ("cc", "gcc", "clang"):
        found = shutil.which(name)
        if found:
            # it is run in another folder
            return [os.path.abspath(found)]
    if importlib.util.find_spec(ZIG_PACKAGE) is not None:
        return [*zig_command(), "c++" if plus else "cc"]
    raise InputRefused(f"{wanted}: no C compiler found; install one (cc), or pip install {ZIG_PACKAGE}")


def zig_command() -> list[str]:
    """The command that runs what comes with the package ziglang."""
    # -P: the folder in which it runs is no place to import from
    return [sys.executable, "-P", "-m", ZIG_PACKAGE]


def fmi_headers() -> Path:
    """The folder of FMI's C headers, which come with FMPy."""
    # found, not imported: that takes longer than what most commands do
    fmpy = importlib.util.find_spec("fmpy")
    assert fmpy is not None and fmpy.origin is not None, "a dependency of this package"
    return Path(fmpy.origin).absolute().parent / "c-code"


def call_compiler(command: Sequence[str], refused: str, late: str, folder: Path, end: float | None = None) -> str:
    """Run a compiler, with limits of time, memory and what it writes; nothing of it is left afterwards.

    Args:
        command: the compiler first.
        refused: begins the sentence if it refuses.
        late: the sentence if it takes too long.
        folder: in which, for its temporary files too.
        end: of `time.monotonic`, until which it may take (s); None: `COMPILE_TIMEOUT` from now.

    Returns:
        The beginning of what it says.

    Raises:
        InputRefused: it refuses, or takes too long.
    """
    patience = COMPILE_TIMEOUT if end is None else max(end - time.monotonic(), 0.0)
    limits = _LIMIT_SCRIPT.format(
        time=math.ceil(COMPILE_TIMEOUT), memory=MAX_COMPILER_MEMORY >> 10, written=MAX_COMPILER_FILE >> 9
    )
    environment = {name: value for name, value in os.environ.items() if name not in COMPILER_VARIABLES}
    # in a file: what a compiler says may have no end
    with tempfile.TemporaryFile(dir=folder) as words:
        process = subprocess.Popen(
            ["/bin/sh", "-c", limits, "sh", *command],
            cwd=folder,
            env={**environment, "TMPDIR": str(folder)},
            stdin=subprocess.DEVNULL,
            stdout=words,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            status = process.wait(patience)
        except subprocess.TimeoutExpired:
            raise InputRefused(late) from None
        finally:
            # what it started too, after Ctrl-C as well; its number is not given away so soon
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()
        words.seek(0)
        text = words.read(MAX_OUTPUT_READ).decode(errors="replace")
    if status:
        lines = text.splitlines()
        errors = [line for line in lines if "error" in line or "undefined" in line]
        reason = (errors or lines or ["without a word"])[0][:MAX_OUTPUT_SHOWN]
        raise InputRefused(f"{refused} with {Path(command[0]).name}: {reason}")
    return text


Stamp = list[int]


class CacheInfo(NamedTuple):
    """What is kept in `folder`: FMUs, bytes of the files that they were unpacked to, and those of these that are not
    as they were last found."""

    folder: Path
    drives: int
    size: int
    changed: tuple[Path, ...]


def cache_info() -> CacheInfo:
    """What there is of unpacked FMUs; nothing is mended.

    Raises:
        InputRefused: see `cache_folder`.
    """
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
    """How the files in `folder` were last found; nothing if that was damaged, too."""
    try:
        known = json.loads((folder / SEAL_FILE).read_bytes())
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


def unpacked(file: Path, digest: str) -> Path:
    """The folder of the unpacked FMU: made once per content, shared by all runs, never seen half-made.

    A file that was changed or removed since is taken from the archive again, which is said on standard error.

    Args:
        file: the FMU, its archive checked by `archive.entries`.
        digest: its `archive.sha256`.

    Raises:
        InputRefused: it cannot be written there.
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
            # a folder where a file should be, say; what is loaded from it stays loaded
            remove(folder)
            _unpack_archive(file, digest, folder)
            lock_against_eviction(folder)
            mended = ["all"]
        # who only looks at what is kept does not wait for what reads FMUs

        install_compiled(digest, folder / CONTENT_FOLDER)
    if mended:
        listed = ", ".join(mended[:3]) + (f" and {len(mended) - 3} more" if len(mended) > 3 else "")
        warning = f"twin: {file.name}: unpacked files had been changed ({listed}): taken from the FMU again"
        print(warning, file=sys.stderr)
    return folder / CONTENT_FOLDER


def _unpack_archive(file: Path, digest: str, folder: Path) -> None:
    """Unpack `file` to `folder`, unless another process does so first."""
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
    """Make the files in `folder` those of the archive `file`; returns which were not."""
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
    with tempfile.NamedTemporaryFile("w", dir=folder, delete=False) as beside:
        json.dump(found, beside)
    os.replace(beside.name, folder / SEAL_FILE)
    return wrong


@lru_cache(MAX_UNPACKED_FMUS)
def _entries(file: Path, digest: str) -> dict[str, zipfile.ZipInfo]:
    """What the archive `file` of that `digest` holds, by its places."""
    with zipfile.ZipFile(file) as archive:
        # the last of two entries with one name is the one that counts
        return {entry_path(info): info for info in archive.infolist()}


def _is_same(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, path: Path) -> bool:
    """Whether the file at `path` holds what the `entry` of `archive` does."""
    try:
        with archive.open(entry) as wanted, path.open("rb") as there:
            while chunk := wanted.read(_CHUNK_SIZE):
                if chunk != there.read(len(chunk)):
                    return False
            return not there.read(1)
    except PermissionError:
        return False


def _extract_entry(archive: zipfile.ZipFile, entry: zipfile.ZipInfo, content: Path) -> None:
    """Take the `entry` of `archive` to its place in `content`; a process that has loaded the old file keeps it."""
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
