"""Which bytes another processor makes, as far as one machine can play it: the compiler's baseline, the C library's."""

import os
import platform
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.laws.runs import EXPERIMENTS
from twin.kernel.recording.reader import read

pytestmark = [
    pytest.mark.endurance,
    pytest.mark.skipif(
        (sys.platform, platform.machine(), platform.libc_ver()[0]) != ("linux", "x86_64", "glibc"),
        reason="plays other x86-64 processors by settings of LLVM and glibc",
    ),
]

COMPILED = {"TWIN_PROCESSOR": "any"}
"""twin's own code for any x86-64 processor, of 2003: SSE2 and neither AVX nor FMA."""
LIBRARY = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-FMA4,-AVX2,-AVX512F"}
"""sin, cos and others of glibc as a processor without FMA takes them; in numpy's and OpenBLAS' code nothing changes."""
MOVED = ("step_z_air", "pressing", "fig4_force_position")


def recordings(folder: Path, setting: dict[str, str]) -> dict[str, Path]:
    """A run of each of `MOVED`, by processes of their own with `setting`, whose code is compiled anew."""
    environment = {**os.environ, **setting, "NUMBA_CACHE_DIR": str(folder / "compiled")}
    for name in MOVED:
        command = [sys.executable, "-m", "twin", "run", EXPERIMENTS / f"{name}.toml", "--out", folder / name]
        subprocess.run(list(map(str, command)), env=environment, check=True, capture_output=True)
    return {name: folder / name / "run.mcap" for name in MOVED}


@pytest.fixture(scope="module")
def here(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    return recordings(tmp_path_factory.mktemp("here"), {})


def test_the_baseline_of_the_compiler_moves_no_byte(here: dict[str, Path], tmp_path: Path):
    """LLVM is not allowed to contract a * b + c, nor to add in another order."""
    for name, other in recordings(tmp_path, COMPILED).items():
        assert other.read_bytes() == here[name].read_bytes(), name


def test_a_c_library_without_fma_moves_last_bits_only(here: dict[str, Path], tmp_path: Path):
    for name, other in recordings(tmp_path, LIBRARY).items():
        one, two = read(here[name]), read(other)
        for field in one.fields():
            # 1e-9 of SI units, or of a count: a thousand times what was measured, and no count is another
            np.testing.assert_allclose(two[field], one[field], rtol=0, atol=1e-9, err_msg=f"{name}: {field}")
