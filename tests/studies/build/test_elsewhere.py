"""Libraries for other platforms where something plays them: wine for Windows, QEMU for Linux on Arm."""

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

from tests.studies.build.conftest import FIG4, ROOT, silent
from tests.studies.build.test_computer import counted, fed, recorded, recorder, sizes
from twin.robot.assembly.load import load_experiment
from twin.robot.run.trace import run_in_memory
from twin.studies.build.library import build_c

WINE = shutil.which("wine")
DRIVER = Path(__file__).with_name("driver.c")
HEADERS = Path(fmpy.__file__).parent / "c-code"

ARM = shutil.which("qemu-aarch64")
ZIG = [sys.executable, "-m", "ziglang", "cc"]
MASSAGE = ROOT / "experiments" / "massage.toml"
# roundings of sin, cos, exp, log, pow, tanh, expm1 and atan2, which end in another bit in up to a fifth of all calls;
# in 20,000 steps at most 8e-13 of a range was seen
SHARE = 1e-11

pytestmark = pytest.mark.endurance
needs_wine = pytest.mark.skipif(WINE is None, reason="wine is not installed")
needs_qemu = pytest.mark.skipif(ARM is None, reason="qemu-aarch64 is not installed")


def wine(folder: Path) -> dict[str, str]:
    """Surroundings of a program under wine, whose own files go into `folder`."""
    return dict(os.environ) | {"WINEPREFIX": str(folder / "wine"), "WINEDEBUG": "-all"}


@pytest.fixture(scope="module")
def drivers(tmp_path_factory: pytest.TempPathFactory) -> dict[str, list[str]]:
    """The same program for both, as commands."""
    pytest.importorskip("ziglang")
    folder = tmp_path_factory.mktemp("drivers")
    zig = [*ZIG, "-O1", "-I", str(HEADERS), str(DRIVER)]
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
    command = [*driver, str(library), str(model.guid), "0.001", "rows", "out"]
    done = subprocess.run(command, cwd=folder, env=wine(folder.parent), capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return outputs, np.fromfile(folder / "out").reshape(len(rows), len(outputs))


@needs_wine
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
    assert np.all(np.abs(there - here).max(axis=0) <= SHARE * ranges)


@pytest.mark.parametrize("experiment", [FIG4, MASSAGE])
@pytest.mark.parametrize(
    ("platform", "linked", "player"),
    [
        pytest.param("x86_64-windows", ["-target", "x86_64-windows-gnu"], WINE, marks=needs_wine),
        pytest.param("aarch64-linux", ["-target", "aarch64-linux-musl", "-static"], ARM, marks=needs_qemu),
    ],
)
def test_the_robots_computer_differs_elsewhere_by_roundings_of_mathematics(
    tmp_path: Path, platform: str, linked: list[str], player: str, experiment: Path
) -> None:
    pytest.importorskip("ziglang")
    build_c(experiment, [platform], tmp_path, [], silent)
    run, outputs = run_in_memory(load_experiment(experiment)), sizes(experiment)
    source, program = tmp_path / "recorder.c", tmp_path / "recorder.exe"
    source.write_text(recorder(outputs, {}))
    library = tmp_path / platform / "libcomputer.a"
    subprocess.run([*ZIG, *linked, "-O1", f"-I{tmp_path}", str(source), str(library), "-o", str(program)], check=True)
    told = fed([player, str(program)], outputs, counted(run), wine(tmp_path))
    for name, values in told.items():
        exact = recorded(run, name)
        assert np.abs(values - exact).max() <= SHARE * np.ptp(exact), name
