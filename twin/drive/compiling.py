"""FMUs that bring sources and no binary for this platform: compiled once, by the user's leave, and kept by content.

The sources run with the user's rights once they are a binary, as every FMU does; nothing compiles them unasked.
"""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Sequence
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from twin.archive import place
from twin.cache_folder import PRIVATE, REMEDY, cache_folder, discard_foreign
from twin.drive import COMPILED
from twin.errors import InputRefused, disk_refusals

FACTS = "compiler.json"
PATIENCE = 300.0
"""s. Honest sources of thousands of lines take some ten."""
CPLUSPLUS = (".cpp", ".cc", ".cxx")
SHOWN = 300
"""Characters of what a compiler says."""

# FMI 2.0's header has no way to leave out the prefix that sources for static linking define
_WITHOUT_PREFIX = """#undef FMI2_FUNCTION_PREFIX
#include_next <fmi2Functions.h>
"""


class Compiled(NamedTuple):
    """A library that was compiled here.

    Attributes:
        library: where it is kept.
        compiler: what made it, with its version.
    """

    library: Path
    compiler: str


def compiled(digest: str, binary: str) -> Compiled | None:
    """The library of the FMU with SHA-256 `digest`, if it was compiled for this platform.

    Args:
        digest: of the archive.
        binary: its place in the archive, as it would be.
    """
    folder = _kept(digest)
    library = folder / binary
    try:
        facts = json.loads((folder / FACTS).read_bytes())
    except (OSError, ValueError, RecursionError):
        return None
    return Compiled(library, str(facts.get("compiler"))) if library.is_file() else None


def _kept(digest: str) -> Path:
    """The folder of what was compiled of the FMU with SHA-256 `digest`; what lies there is the user's own.

    Raises:
        InputRefused: see `cache_folder`.
    """
    folder = cache_folder(COMPILED) / digest
    with disk_refusals(folder, "cannot be removed", InputRefused, REMEDY):
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


def supply(digest: str, content: Path) -> None:
    """Put what was compiled of the FMU with that SHA-256 into the folder `content` of its unpacked files.

    Raises:
        OSError: it cannot be written there.
    """
    folder = _kept(digest)
    for library in folder.glob("binaries/*/*"):
        target = content / library.relative_to(folder)
        if not target.is_file() or target.stat().st_mtime_ns != library.stat().st_mtime_ns:
            target.parent.mkdir(parents=True, exist_ok=True)
            beside = target.with_name(f".{os.getpid()}-{target.name}")
            shutil.copy2(library, beside)
            os.replace(beside, target)


def compile_sources(file: Path, digest: str, model: Any, binary: str) -> Compiled:
    """Compile the sources of `file` for this platform, unless that was done before.

    Args:
        file: the FMU, its archive checked.
        digest: its SHA-256.
        model: its description by FMPy, with the build configurations.
        binary: where its library would be in the archive.

    Raises:
        InputRefused: it has no sources that say how to be compiled, there is no compiler, or the compiler refuses.
    """
    done = compiled(digest, binary)
    if done is not None:
        return done
    sets = source_sets(model, PurePosixPath(binary).stem)
    if not sets:
        raise InputRefused(f"{file}: holds no sources that it tells how to compile; export it for this platform")
    home = cache_folder(COMPILED)
    with (
        disk_refusals(file, f"cannot be compiled in {home}", InputRefused, REMEDY),
        tempfile.TemporaryDirectory(dir=home, prefix=f".{digest[:12]}-") as scratch,
    ):
        made = _linked(file, sets, Path(scratch), binary)
        with (Path(scratch) / "kept" / FACTS).open("w") as facts:
            json.dump({"compiler": made.compiler}, facts)
        try:
            os.rename(Path(scratch) / "kept", home / digest)
        # somebody else was faster
        except OSError:
            if compiled(digest, binary) is None:
                raise
    return Compiled(home / digest / binary, made.compiler)


def _linked(file: Path, sets: Sequence[Any], scratch: Path, binary: str) -> Compiled:
    with zipfile.ZipFile(file) as archive:
        for entry in archive.infolist():
            name = place(entry)
            if name.startswith("sources/") and not name.endswith("/"):
                target = scratch / name
                target.parent.mkdir(parents=True, exist_ok=True)
                target.write_bytes(archive.read(entry))
    library = scratch / "kept" / binary
    (scratch / "kept").mkdir(PRIVATE)
    library.parent.mkdir(parents=True)
    headers = scratch / "headers"
    headers.mkdir()
    (headers / "fmi2Functions.h").write_text(_WITHOUT_PREFIX)
    includes = [f"-I{headers}", f"-I{scratch / 'sources'}", f"-I{fmi_headers()}"]
    said = (
        f"{file}: its sources do not compile",
        f"{file}: its sources still compile after {PATIENCE:g} s; build it elsewhere",
    )
    objects: list[str] = []
    plus = False
    for number, one in enumerate(sets):
        options = [f"-D{d.name}" + (f"={d.value}" if d.value else "") for d in one.preprocessorDefinitions]
        options += [f"-I{_inside(file, scratch, name)}" for name in one.includeDirectories]
        for source in one.sourceFiles:
            target = scratch / f"{number}_{len(objects)}.o"
            is_plus = source.lower().endswith(CPLUSPLUS)
            plus |= is_plus
            where = str(_inside(file, scratch, source))
            call_compiler(
                [*compiler(file, is_plus), "-c", "-O2", "-fPIC", "-w", "-DFMI3_OVERRIDE_FUNCTION_PREFIX",
                 *options, *includes, where, "-o", str(target)], *said,
            )  # fmt: skip
            objects.append(str(target))
    linker = compiler(file, plus)
    call_compiler([*linker, "-shared", *objects, "-lm", "-o", str(library)], *said)
    version = subprocess.run([*linker, "--version"], capture_output=True, text=True, check=False).stdout
    return Compiled(library, (version.splitlines() or [linker[0]])[0].strip())


def _inside(file: Path, scratch: Path, name: str) -> Path:
    """The place of a source or folder that the FMU names, which is below its sources."""
    home = (scratch / "sources").resolve()
    path = (home / name).resolve()
    if not path.is_relative_to(home) or not path.exists():
        raise InputRefused(f"{file}: its sources hold no '{name}', which it says to compile; export it again")
    return path


def compiler(wanted: Path, plus: bool = False) -> list[str]:
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
            return [found]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "c++" if plus else "cc"]
    raise InputRefused(f"{wanted}: there is no C compiler to build it with; install one (cc), or pip install ziglang")


def fmi_headers() -> Path:
    """The folder of FMI's C headers, which come with FMPy."""
    # found, not imported: that takes longer than what most commands do
    fmpy = importlib.util.find_spec("fmpy")
    assert fmpy is not None and fmpy.origin is not None, "a dependency of this package"
    return Path(fmpy.origin).parent / "c-code"


def call_compiler(command: Sequence[str], refused: str, late: str, folder: Path | None = None) -> None:
    """Run a compiler.

    Args:
        command: the compiler first.
        refused: begins the sentence if it refuses.
        late: the sentence if it takes longer than `PATIENCE`.
        folder: in which; else the present one.

    Raises:
        InputRefused: it refuses, or takes too long.
    """
    try:
        done = subprocess.run(
            command, cwd=folder, capture_output=True, text=True, timeout=PATIENCE, errors="replace", check=False
        )
    except subprocess.TimeoutExpired:
        raise InputRefused(late) from None
    if done.returncode:
        errors = [line for line in done.stderr.splitlines() if "error" in line or "undefined" in line]
        said = (errors or done.stderr.splitlines() or ["without a word"])[0][:SHOWN]
        raise InputRefused(f"{refused} with {Path(command[0]).name}: {said}")
