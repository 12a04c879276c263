"""Compiles drives for tests with the machine's C compiler, from the sources inside a good drive."""

import importlib.util
import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from tests.kernel.fmi.archives import altered

Edit = Callable[[str], str]
ACCESS = """#include "slave.h"
bool holds(const Variable *variable, double value) { (void)variable; (void)value; return true; }
"""
"""In place of access.c where the table of variables is empty: fmu_state.c asks it for every value of a state."""


def compiled_library(good: Path, work: Path, replaced: Mapping[str, str | Edit]) -> bytes:
    """The shared library of `good`'s sources, some of them `replaced` or edited, built in `work`.

    Skips without a compiler, but not on CI, which has one.
    """
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None or not sys.platform.startswith("linux"):
        assert "CI" not in os.environ, "this test compiles a drive and CI has to have a C compiler"
        pytest.skip("compiles a drive: needs Linux and a C compiler")
    with zipfile.ZipFile(good) as archive:
        archive.extractall(work)
    sources = work / "sources"
    for file, content in replaced.items():
        path = sources / file
        path.write_text(content if isinstance(content, str) else content(path.read_text()))
    fmpy = importlib.util.find_spec("fmpy")
    assert fmpy is not None and fmpy.origin is not None
    headers = Path(fmpy.origin).parent / "c-code"
    library = work / "drive.so"
    command = [compiler, "-shared", "-fPIC", "-O1", f"-I{sources}", f"-I{headers}"]
    # all in one: headers are read once
    together = "".join(f'#include "{source.name}"\n' for source in sorted(sources.glob("*.c")))
    subprocess.run([*command, "-x", "c", "-", "-lm", "-o", str(library)], input=together.encode(), check=True)
    return library.read_bytes()


def compiled_drive(root: Path, folder: Path, name: str, replaced: Mapping[str, str | Edit]) -> Path:
    """`folder`/`name`.fmu: velocity_servo with some of its sources `replaced` or edited."""
    good = root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
    content = compiled_library(good, folder / f"{name}.build", replaced)
    return altered(
        good, folder / f"{name}.fmu", lambda n, c: (n, content if n == "binaries/linux64/velocity_servo.so" else c)
    )
