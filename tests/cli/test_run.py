"""The command line as a user types it, in a process of its own."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.drive.archives import redescribed
from twin.recording.reader import read

FIG4 = "experiments/fig4_force_position.toml"


def twin(*arguments: object, cwd: Path, **settings) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "twin", *map(str, arguments)]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=300, **settings)


def test_a_run_lands_in_its_own_folder_and_latest_points_to_it(root: Path, tmp_path: Path):
    done = twin("run", root / FIG4, "--set", "duration_s=1", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    home = tmp_path / "results" / "fig4_force_position"
    assert sorted(path.name for path in (home / "latest").resolve().iterdir()) == ["run.mcap", "summary.json"]
    assert done.stdout.startswith("fig4_force_position  1 s at ")
    assert read(home / "latest" / "run.mcap").complete


def test_out_names_the_runs_own_folder_with_one_recording(root: Path, tmp_path: Path):
    done = twin("run", root / FIG4, "--set", "duration_s=1", "--out", "mine", "--json", cwd=tmp_path)
    facts = json.loads(done.stdout)
    assert [path.name for path in (tmp_path / "mine").glob("*.mcap")] == ["run.mcap"]
    assert facts["recording"] == "mine/run.mcap"
    again = twin("run", root / FIG4, "--set", "duration_s=1", "--out", "mine", cwd=tmp_path)
    assert again.returncode == 2
    assert "a run is never overwritten" in again.stderr


@pytest.mark.parametrize("drive", ["pmsm_foc", "ideal_velocity", "velocity_servo"])
def test_any_drive_can_take_the_place_of_the_experiments(root: Path, tmp_path: Path, drive: str):
    done = twin("run", root / FIG4, "--drive", root / "fmus" / drive, "--set", "duration_s=1", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert f"drive {drive}.fmu  FMI 2.0  sha256 " in done.stdout


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["nowhere.toml"], "no such experiment file"),
        ([FIG4, "--drive", "nowhere"], "no such drive"),
        ([FIG4, "--set", "controller.force.kp_N=1"], "did you mean 'kp_mm_per_N'?"),
        ([FIG4, "--set", "drive.parameters.drop=1"], "did you mean 'droop'?"),
        ([FIG4, FIG4, "--out", "x"], "names the folder of one run"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(root: Path, tmp_path: Path, arguments: list[str], said: str):
    given = [root / a if a == FIG4 else a for a in arguments]
    done = twin("run", *given, cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.rglob("*.mcap"))


def test_an_fmu_that_can_live_only_once_in_a_process_runs_with_isolated_drives(root: Path, tmp_path: Path):
    good = root / "fmus/velocity_servo/velocity_servo.fmu"
    flag = 'canBeInstantiatedOnlyOncePerProcess="true"'
    single = redescribed(good, tmp_path / "single.fmu", "<CoSimulation ", f"<CoSimulation {flag} ")
    arguments = ["run", root / FIG4, "--drive", single, "--set", "duration_s=0.5"]
    refused = twin(*arguments, cwd=tmp_path)
    assert refused.returncode == 2
    assert "can be instantiated only once per process" in refused.stderr
    assert "--isolate drive" in refused.stderr
    assert twin(*arguments, "--isolate", "drive", cwd=tmp_path).returncode == 0


def test_ctrl_c_in_mid_run_keeps_what_was_recorded(root: Path, tmp_path: Path):
    command = [sys.executable, "-m", "twin", "run", str(root / FIG4), "--set", "duration_s=4000", "--out", "x"]
    process = subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    partial = tmp_path / "x" / "run.mcap.partial"
    while not (partial.exists() and partial.stat().st_size > 1_000_000):
        assert process.poll() is None, process.stderr
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    assert "interrupted; recorded until then: x/run.mcap.partial" in stderr
    assert "Traceback" not in stderr
    recording = read(partial)
    assert not recording.complete
    assert len(recording["plant.p_B"]) > 1000


@pytest.mark.skipif(os.name == "nt", reason="limits a file's size with ulimit")
def test_a_full_disk_is_one_sentence_and_leaves_nothing_that_looks_finished(root: Path, tmp_path: Path):
    command = f'ulimit -f 2000; "{sys.executable}" -m twin run "{root / FIG4}" --out x'
    # numba would want to write its cache under the same limit
    twin("run", root / FIG4, "--set", "duration_s=0.1", cwd=tmp_path)
    done = subprocess.run(["bash", "-c", command], cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 3
    assert "run.mcap.partial" in done.stderr
    assert "Traceback" not in done.stderr
    assert [path.name for path in (tmp_path / "x").iterdir()] == ["run.mcap.partial"]
    assert len(read(tmp_path / "x" / "run.mcap.partial")["plant.p_B"]) > 0


def test_help_fits_80_columns_and_names_every_command(tmp_path: Path):
    done = twin("--help", cwd=tmp_path, env=os.environ | {"COLUMNS": "80"})
    assert done.returncode == 0
    assert all(command in done.stdout for command in ("run", "compare", "drive"))
    assert max(len(line) for line in done.stdout.splitlines()) <= 80
