"""Compiles drives that go wrong with the machine's C compiler, in the clothes of velocity_servo."""

import importlib.util
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from tests.drive.archives import altered

Edit = Callable[[str], str]


def compiled_drive(
    root: Path, folder: Path, name: str, model: Path | None = None, edits: Mapping[str, Edit] | None = None
) -> Path:
    """`folder`/`name`.fmu: velocity_servo with another model.c, or with `edits` of its sources by file name.

    Skips without a compiler, but not on CI, which has one.
    """
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None or not sys.platform.startswith("linux"):
        assert "CI" not in os.environ, "this test compiles a drive and CI has to have a C compiler"
        pytest.skip("compiles a drive: needs Linux and a C compiler")
    good = root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
    work = folder / f"{name}.build"
    with zipfile.ZipFile(good) as archive:
        archive.extractall(work)
    sources = work / "sources"
    if model is not None:
        shutil.copy(model, sources / "model.c")
    for file, edit in (edits or {}).items():
        (sources / file).write_text(edit((sources / file).read_text()))
    fmpy = importlib.util.find_spec("fmpy")
    assert fmpy is not None and fmpy.origin is not None
    headers = Path(fmpy.origin).parent / "c-code"
    library = work / "drive.so"
    command = [compiler, "-shared", "-fPIC", "-O1", f"-I{sources}", f"-I{headers}"]
    subprocess.run([*command, *map(str, sorted(sources.glob("*.c"))), "-lm", "-o", str(library)], check=True)
    content = library.read_bytes()
    return altered(
        good, folder / f"{name}.fmu", lambda n, c: (n, content if n == "binaries/linux64/velocity_servo.so" else c)
    )
