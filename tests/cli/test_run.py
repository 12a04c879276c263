"""`twin run` as a user types it."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from tests.command_line import twin, twin_process
from tests.kernel.fmi.archives import redescribed
from twin.kernel.recording.reader import read
from twin.robot.assembly.load import load_experiment

FIG4 = "experiments/fig4_force_position.toml"


def test_a_run_lands_in_its_own_folder_and_latest_points_to_it(root: Path, tmp_path: Path):
    done = twin_process("run", root / FIG4, "--set", "duration_s=1", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    home = tmp_path / "results" / "fig4_force_position"
    assert sorted(path.name for path in (home / "latest").resolve().iterdir()) == ["run.mcap", "summary.json"]
    assert done.stdout.startswith("fig4_force_position  1 s at ")
    assert done.stdout.endswith("  next       twin report results/fig4_force_position\n")
    assert "\x1b" not in done.stdout + done.stderr
    assert read(home / "latest" / "run.mcap").complete


def test_a_run_that_is_refused_leaves_nothing_behind(root: Path, tmp_path: Path):
    done = twin("run", root / "experiments/pressing.toml", "--set", "contact.height_mm=500", cwd=tmp_path)
    assert done.returncode == 2 and "out of reach" in done.stderr
    assert not list(tmp_path.glob("results/pressing/*"))


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
    assert f"  drive      {drive}.fmu  FMI 2.0" in done.stdout.splitlines()


PRESSING = "experiments/pressing.toml"
JUMP_UP = (
    "--set",
    "contact.shift.by_mm=[0, 0, 8]",
    "--set",
    "contact.shift.start_s=3",
    "--set",
    "contact.shift.rise_s=0.05",
)
"""A person who rises by 8 mm within 50 ms."""


def test_any_body_can_take_the_place_of_the_experiments(root: Path, tmp_path: Path):
    done = twin("run", root / PRESSING, "--body", "back", "--out", "x", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    contact = json.loads(read(tmp_path / "x" / "run.mcap").metadata["experiment"]["values"])["contact"]
    assert (contact["body"], contact["kind"], contact["law"]) == ("back", "skin", "exponential")
    assert "surface at z = -101.0 mm, height_mm of back.toml (assumed: as high as" in " ".join(done.stdout.split())


def test_what_happened_in_a_run_is_told_with_its_time_but_for_what_is_for_debugging(root: Path, tmp_path: Path):
    fault = "fault=[{kind='breathing', onset_s=3.25, magnitude_mm=0.5}]"
    done = twin("run", root / PRESSING, "--set", fault, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "   0.000 s  task 1 (press) of 1 begins\n" in done.stdout
    assert "   3.250 s  fault 1 (breathing of contact) begins\n" in done.stdout
    assert "build-up" not in done.stdout


def test_a_trip_that_no_fault_explains_ends_with_exit_code_4_and_leaves_the_recording(root: Path, tmp_path: Path):
    done = twin("run", root / PRESSING, *JUMP_UP, "--out", "x", "--json", cwd=tmp_path)
    assert done.returncode == 4, done.stderr
    facts = json.loads(done.stdout)
    assert facts["trip"].startswith("safety monitor: ")
    assert facts["trip"] in " ".join(done.stderr.split())
    assert [event["text"] for event in facts["events"] if event["level"] == "ERROR"] == [facts["trip"]]
    recording = read(tmp_path / "x" / "run.mcap")
    assert recording.complete
    assert recording["monitor.tripped"][-1]


def test_a_trip_because_of_a_fault_is_what_was_to_be_seen(root: Path, tmp_path: Path):
    fault = "fault=[{kind='surface_jump', onset_s=3.0, magnitude_mm=8}]"
    done = twin("run", root / PRESSING, "--set", fault, "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["trip"].startswith("safety monitor: ")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ([PRESSING, "--body", "bakc"], "no such body; did you mean 'back'?"),
        ([PRESSING, "--set", "task.1.point_mm=[200, 0]"], "[task 1] p_B = (200.0, 0.0, -130.0) mm is out of reach"),
        (["nowhere.toml"], "no such experiment file"),
        ([FIG4, "--drive", "nowhere"], "no such drive"),
        ([FIG4, "--set", "controller.force.kp_N=1"], "did you mean 'kp_mm_per_N'?"),
        ([FIG4, "--set", "drive.parameters.drop=1"], "did you mean 'droop'?"),
        ([FIG4, FIG4, "--out", "x"], "names the folder of one run"),
    ],
)
def test_bad_input_is_one_sentence_and_exit_code_2(root: Path, tmp_path: Path, arguments: list[str], said: str):
    given = [root / a if a in (FIG4, PRESSING) else a for a in arguments]
    done = twin("run", *given, cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.rglob("*.mcap"))


def test_an_fmu_that_can_live_only_once_in_a_process_gets_three_by_itself(root: Path, tmp_path: Path):
    good = root / "fmus/velocity_servo/velocity_servo.fmu"
    flag = 'canBeInstantiatedOnlyOncePerProcess="true"'
    single = redescribed(good, tmp_path / "single.fmu", "<CoSimulation ", f"<CoSimulation {flag} ")
    trace = ["run", root / FIG4, "--set", "duration_s=0.5"]
    for fmu in (single, good):
        assert twin(*trace, "--drive", fmu, "--out", fmu.stem, cwd=tmp_path).returncode == 0
    there, here = (read(tmp_path / fmu.stem) for fmu in (single, good))
    assert np.array_equal(there["plant.F_ee_B"], here["plant.F_ee_B"])


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


@pytest.mark.slow
def test_ctrl_c_while_code_is_compiled_leaves_nothing(root: Path, tmp_path: Path):
    command = [sys.executable, "-m", "twin", "run", str(root / FIG4), "--out", "x"]
    nothing_compiled = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "compiled")}
    process = subprocess.Popen(command, cwd=tmp_path, env=nothing_compiled, stderr=subprocess.PIPE, text=True)
    while not (tmp_path / "x").exists():
        assert process.poll() is None, process.stderr
        time.sleep(0.01)
    # seven seconds of one core are compiled from here on
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=60)
    assert process.returncode == 130
    assert stderr.splitlines()[-1] == "interrupted before the first step; nothing is recorded"
    assert not (tmp_path / "x").exists()


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


def test_help_says_how_a_value_of_a_task_is_set_and_that_does_set_it(root: Path):
    said = " ".join(twin("run", "--help", cwd=root).stdout.split())
    (setting,) = re.findall(r"task\.1\.\S+=\d+", said)
    assert load_experiment(root / "experiments/pressing.toml", [setting]).tasks[0].force == float(
        setting.partition("=")[2]
    )
