"""The libraries for Windows under wine, against those for Linux: the same program steps both."""

import os
import shutil
import subprocess
import sys
import zipfile
from collections.abc import Callable
from pathlib import Path

import fmpy
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.studies.build.conftest import FIG4
from twin.runs.assembly.load import load_experiment
from twin.runs.trace import run_in_memory

WINE = shutil.which("wine")
DRIVER = Path(__file__).with_name("driver.c")
HEADERS = Path(fmpy.__file__).parent / "c-code"

pytestmark = [pytest.mark.endurance, pytest.mark.skipif(WINE is None, reason="wine is not installed")]


@pytest.fixture(scope="module")
def drivers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """The same program for both, as commands."""
    pytest.importorskip("ziglang")
    folder = tmp_path_factory.mktemp("drivers")
    zig = [sys.executable, "-m", "ziglang", "cc", "-O1", "-I", str(HEADERS), str(DRIVER)]
    subprocess.run([*zig, "-target", "x86_64-windows-gnu", "-o", str(folder / "driver.exe")], check=True)
    subprocess.run([*zig, "-target", "x86_64-linux-gnu.2.17", "-ldl", "-o", str(folder / "driver")], check=True)
    return {"linux64": [str(folder / "driver")], "win64": [str(WINE), str(folder / "driver.exe")]}


def stepped(
    driver: list[str], file: Path, platform: str, rows: NDArray[np.float64], inputs: list[str], folder: Path
) -> tuple[list[str], NDArray[np.float64]]:
    """Names of all outputs, and their values in each row (rows, outputs)."""
    model = fmpy.read_model_description(str(file))
    references = {v.name: v.valueReference for v in model.modelVariables}
    outputs = [v.name for v in model.modelVariables if v.causality == "output"]
    with zipfile.ZipFile(file) as archive:
        (name,) = (entry for entry in archive.namelist() if entry.startswith(f"binaries/{platform}/"))
        library = folder / Path(name).name
        library.write_bytes(archive.read(name))
    head = [len(inputs), len(outputs), *(references[name] for name in (*inputs, *outputs))]
    (folder / "rows").write_bytes(np.array(head, dtype=float).tobytes() + rows.tobytes())
    wine = {"WINEPREFIX": str(folder.parent / "wine"), "WINEDEBUG": "-all"}
    command = [*driver, str(library), str(model.guid), "0.001", "rows", "out"]
    done = subprocess.run(command, cwd=folder, env=os.environ | wine, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return outputs, np.fromfile(folder / "out").reshape(len(rows), len(outputs))


@pytest.mark.parametrize("part", ["plant", "computer"])
def test_windows_differs_from_linux_by_roundings_of_its_mathematics(
    built: Callable[..., Path], drivers: dict[str, list[str]], tmp_path: Path, part: str
) -> None:
    file = built(part, platforms=("x86_64-windows",))
    run = run_in_memory(load_experiment(FIG4))
    rows, inputs = run.of_drives("theta_m"), [f"theta_m[{n}]" for n in (1, 2, 3)]
    if part == "computer":
        rows = np.hstack([rows, run.held("plant.theta_l")])
        inputs += [f"theta_l[{n}]" for n in (1, 2, 3)]
    found = {}
    for platform, driver in drivers.items():
        (tmp_path / platform).mkdir()
        names, found[platform] = stepped(driver, file, platform, rows, inputs, tmp_path / platform)
    here, there = found["linux64"], found["win64"]
    ranges = np.ptp(here, axis=0)
    assert ranges[names.index("plant.F_ee_B[3]" if part == "plant" else "controller.F_z")] > 4.0
    # roundings of sin, cos, exp, pow, tanh, expm1 and atan2 in 20,000 steps: at most 8e-13 of a range was seen
    assert np.all(np.abs(there - here).max(axis=0) <= 1e-11 * ranges)
