"""Compiles the drive of faulty.c with the machine's C compiler, in the clothes of velocity_servo."""

import importlib.util
import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

from tests.drive.archives import altered

HERE = Path(__file__).parent


def faulty_drive(root: Path, folder: Path) -> Path:
    """The FMU, built in `folder`. Skips without a compiler, but not on CI, which has one."""
    compiler = shutil.which("cc") or shutil.which("gcc") or shutil.which("clang")
    if compiler is None or not sys.platform.startswith("linux"):
        assert "CI" not in os.environ, "this test compiles a drive and CI has to have a C compiler"
        pytest.skip("compiles a drive: needs Linux and a C compiler")
    good = root / "fmus" / "velocity_servo" / "velocity_servo.fmu"
    with zipfile.ZipFile(good) as archive:
        archive.extractall(folder)
    sources = folder / "sources"
    shutil.copy(HERE / "faulty.c", sources / "model.c")
    fmpy = importlib.util.find_spec("fmpy")
    assert fmpy is not None and fmpy.origin is not None
    headers = Path(fmpy.origin).parent / "c-code"
    library = folder / "faulty.so"
    command = [compiler, "-shared", "-fPIC", "-O1", f"-I{sources}", f"-I{headers}"]
    subprocess.run([*command, *map(str, sorted(sources.glob("*.c"))), "-lm", "-o", str(library)], check=True)
    content = library.read_bytes()
    return altered(
        good, folder / "faulty.fmu", lambda n, c: (n, content if n == "binaries/linux64/velocity_servo.so" else c)
    )
