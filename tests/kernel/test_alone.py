"""The kernel without the robot: what is left of twin/ when twin/robot is deleted still runs systems of FMUs."""

import os
import shutil
import sys
from pathlib import Path

import pytest

from tests.command_line import process_run, twin_process
from tests.kernel.systems.archives import archive, component, connection, structure, system, values

LIBRARY = """
from pathlib import Path
from twin.kernel.fmi.description import described
from twin.kernel.recording.reader import read
print(described(Path("a.fmu")).model.modelName, read("results/cosim/two/latest/run.mcap")["b.theta_m"][-1])
"""


@pytest.fixture
def without_robot(root: Path, tmp_path: Path) -> Path:
    """A folder with a copy of twin/ that has no robot in it."""
    home = tmp_path / "home"
    skipped = shutil.ignore_patterns("__pycache__", "carried")
    shutil.copytree(root / "twin", home / "twin", ignore=skipped)
    shutil.rmtree(home / "twin" / "robot")
    return home


@pytest.mark.slow
def test_without_the_robots_folder_systems_run_and_record_the_same(root: Path, tmp_path: Path, without_robot: Path):
    fmu = root / "fmus/ideal_velocity/ideal_velocity.fmu"
    two = system(
        [component("a", "a.fmu", bindings=values("omega_ref=1")), component("b", "a.fmu")],
        [connection("a.omega_m", "b.omega_ref")],
    )
    archive(tmp_path / "two.ssp", structure(two, 0.1), {"a.fmu": fmu})
    shutil.copy(fmu, tmp_path / "a.fmu")
    alone = {**os.environ, "PYTHONPATH": str(without_robot)}
    whole = twin_process("cosim", "two.ssp", "--out", "whole", "--json", cwd=tmp_path)
    left = twin_process("cosim", "two.ssp", "--json", cwd=tmp_path, env=alone)
    assert (whole.returncode, left.returncode) == (0, 0), left.stderr
    recorded = tmp_path / "results/cosim/two/latest/run.mcap"
    assert recorded.read_bytes() == (tmp_path / "whole/run.mcap").read_bytes()
    read = process_run([sys.executable, "-c", LIBRARY], cwd=tmp_path, env=alone)
    assert read.returncode == 0, read.stderr
    assert read.stdout.startswith("ideal_velocity ")
    # nothing of the robot is found elsewhere
    assert process_run([sys.executable, "-c", "import twin.robot"], cwd=tmp_path, env=alone).returncode != 0
