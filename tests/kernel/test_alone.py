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


FROM_PYTHON = """
import re, sys
from pathlib import Path
import twin
from twin.kernel.errors import TwinError
from twin.kernel.recording.export.export import export_recording
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.reader import read_log
from twin.kernel.recording.messages import Field, Topic
from twin.kernel.recording.writer import Writer

with twin.Cosimulation(tick=1e-3, stop=0.1) as two:
    two.load("a", "a.fmu", omega_ref=1.0)
    two.load("b", "a.fmu")
    two.wire("a.omega_m", "b.omega_ref")
    seen = two.observe("b.theta_m")
    two.run()
rows = seen["b.theta_m"]
with Writer(Path("run.mcap"), [Topic("b", (Field("angle", 1, "double", "rad", ""),), 1)], 1e-3, {}) as writer:
    writer.write("b", 0, rows.reshape(-1, 1))
assert twin.read("run.mcap")["b.angle"].tolist() == rows.tolist()
for form in ("csv", "mat", "ros2"):
    export_recording(Path("run.mcap"), form)
assert read_log("run.csv", known={"b.angle": "rad"})["b.angle"].values.tolist() == rows.tolist()


def refused(act):
    try:
        act()
    except TwinError as problem:
        # neither a traceback nor an internal error: a sentence
        assert str(problem) and problem.exit_code in (2, 3), problem
        print(type(problem).__name__, str(problem).splitlines()[0])
    else:
        raise AssertionError(act)


def wrong(name):
    with twin.Cosimulation(tick=1e-3, stop=0.1) as one:
        one.load("a", "a.fmu", **{name: 1.0})
        one.run()


Path("bad.csv").write_text("t_s,F_N\\n0,x\\n1,y\\n")
refused(lambda: wrong("omega_rev"))
refused(lambda: twin.Cosimulation().load("a", "none.fmu"))
refused(lambda: twin.read("none.mcap"))
refused(lambda: twin.read("run.mcap")["b.angel"])
refused(lambda: read_log("bad.csv"))
refused(lambda: read_log("run_ros2", column_map(["F=/none.x"])))
refused(lambda: column_map(["x"]))
refused(lambda: export_recording(Path("run.mcap"), "csv"))
"""


@pytest.fixture
def kernel_alone(root: Path, tmp_path: Path) -> Path:
    """A folder with a copy of twin/ that has nothing but the kernel in it."""
    home = tmp_path / "kernel"
    shutil.copytree(root / "twin" / "kernel", home / "twin" / "kernel", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(root / "twin" / "__init__.py", home / "twin")
    return home


@pytest.mark.slow
def test_the_kernel_alone_runs_records_reads_and_refuses_in_sentences(root: Path, tmp_path: Path, kernel_alone: Path):
    shutil.copy(root / "fmus/ideal_velocity/ideal_velocity.fmu", tmp_path / "a.fmu")
    alone = {**os.environ, "PYTHONPATH": str(kernel_alone)}
    done = process_run([sys.executable, "-c", FROM_PYTHON], cwd=tmp_path, env=alone)
    assert done.returncode == 0, done.stderr
    assert len(done.stdout.splitlines()) == 8 and "did you mean 'omega_ref'?" in done.stdout


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
