"""What a drive FMU can do to its host, and what becomes of a run: by default nothing but the run is lost."""

import json
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.command_line import process_run
from tests.kernel.fmi.archives import altered
from tests.kernel.process.hostile import (
    ABORT,
    EXIT,
    EXPERIMENT,
    FLOOD,
    FORK,
    HANG,
    HANG_IN_INITIALISATION,
    LEAK,
    MOVE,
    NONE,
    SEGFAULT,
    SEGFAULT_IN_FREE,
    Command,
)
from twin.kernel.recording.reader import read

IN_STEP = "in the step from t = 0.999 s, tick 999, in fmi2DoStep or the set and get calls around it"
KEPT = 0.899
"""Simulated time (s) in the file when tick 999 is stepped: slices have 100 ticks of 1 ms, and at tick rate each fills a
chunk, so a crash costs the slice in which it happens.
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("attack", "manner"),
    [
        (SEGFAULT, "crashed (SIGSEGV, segmentation fault)"),
        (ABORT, "aborted the process (SIGABRT)"),
        (EXIT, "ended the process with exit(0)"),
        (HANG, "did not return within 1 s"),
        (FORK, "crashed (SIGSEGV, segmentation fault)"),
    ],
)
def test_a_drive_that_kills_its_process_in_a_step_is_named(command: Command, drive: Path, attack: int, manner: str):
    done = command.run(drive, attack, "--limit-step", "1")
    assert done.returncode == 3
    assert done.stderr.startswith(f"hostile.fmu (drive_2) {manner} {IN_STEP}. Last inputs: omega_ref = ")
    assert " rad/s, tau_load = " in done.stderr
    assert "Traceback" not in done.stderr
    recording = read(command.folder / "x" / "run.mcap.partial")
    assert recording.time("plant")[-1] == KEPT
    assert f"Recorded until then: x/run.mcap.partial ({KEPT} s)." in done.stderr
    assert command.survivors() == []
    assert command.leftovers() == []


@pytest.mark.slow
def test_a_drive_that_hangs_before_the_first_step_is_refused(command: Command, drive: Path):
    done = command.run(drive, HANG_IN_INITIALISATION, "--limit-step", "1")
    assert done.returncode == 2
    said = "hostile.fmu (drive_2) did not return within 1 s in fmi2ExitInitializationMode, before the first step."
    assert done.stderr.startswith(said)
    assert command.survivors() == []
    assert command.leftovers() == []


@pytest.mark.slow
def test_a_drive_that_crashes_when_freed_takes_no_recording_with_it(command: Command, drive: Path):
    done = command.run(drive, SEGFAULT_IN_FREE)
    assert done.returncode == 3
    said = "crashed (SIGSEGV, segmentation fault) in fmi2FreeInstance, at t = 2 s, tick 2000."
    assert done.stderr.startswith(f"hostile.fmu (drive_2) {said}")
    assert "The recording is complete: x/run.mcap." in done.stderr
    assert read(command.folder / "x" / "run.mcap").complete
    assert command.survivors() == []


@pytest.mark.slow
def test_a_drive_that_leaks_is_stopped_at_the_limit(command: Command, drive: Path):
    done = command.run(drive, LEAK, "--limit-memory", "800")
    assert done.returncode == 3
    assert "was at work when the process reached the limit of 800 MB of memory" in done.stderr
    assert "`--isolate drive` shows which drive grows" in done.stderr
    assert read(command.folder / "x" / "run.mcap.partial").time("plant")[-1] > 0.5
    assert command.survivors() == []


def test_megabytes_on_standard_output_reach_nobody_who_reads_results(command: Command, drive: Path):
    done = command.run(drive, FLOOD, "--json")
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["recording"] == "x/run.mcap"
    # the last kilobytes are passed on for whoever debugs with printf, each line of the same once
    assert 0 < len(done.stderr) <= 8192
    *_, last = done.stderr.splitlines()
    assert re.fullmatch(r"x+  \(\d+ times\)", last)
    assert set(done.stderr.replace(last, "")) <= {"x", "\n"}


@pytest.mark.slow
def test_a_drive_that_changes_folder_and_locale_changes_no_byte_of_the_result(command: Command, drive: Path):
    recordings = []
    for attack in (NONE, MOVE):
        done = command.run(drive, attack)
        assert done.returncode == 0, done.stderr
        assert "\n  recording  x/run.mcap\n" in done.stdout
        recording = read(command.folder / "x" / "run.mcap")
        recordings.append(recording.streams["plant"].records.tobytes())
        (command.folder / "x").rename(command.folder / str(attack))
    assert recordings[0] == recordings[1]


@pytest.mark.slow
def test_a_run_that_takes_too_long_ends_at_its_time_limit(command: Command, drive: Path):
    done = command.run(drive, NONE, "--set", "duration_s=4000", "--limit-wall", "4")
    assert done.returncode == 3
    assert "the time limit of 4 s was over" in done.stderr
    assert (command.folder / "x" / "run.mcap.partial").exists()
    assert command.survivors() == []


def test_a_killed_parent_leaves_no_orphan(command: Command, drive: Path):
    arguments = command.arguments(drive, HANG, "--limit-step", "1000")
    parent = subprocess.Popen(arguments, cwd=command.folder, env=command.environment)
    deadline = time.monotonic() + 60
    partial = command.folder / "x" / "run.mcap.partial"
    while not partial.exists() and time.monotonic() < deadline:
        time.sleep(0.05)
    assert len(command.survivors()) == 2
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    while command.survivors() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert command.survivors() == []


@pytest.mark.slow
def test_a_drive_that_crashes_on_the_bench_is_named(command: Command, drive: Path):
    mapping = command.folder / "hostile.toml"
    mapping.write_text(f'fmu = "{drive}"\n[parameters]\ndroop = {SEGFAULT}\n')
    checked = [sys.executable, "-m", "twin", "drive", "check", str(mapping)]
    done = process_run(checked, cwd=command.folder, env=command.environment, timeout=120)
    assert done.returncode == 3
    assert done.stderr.startswith("hostile.fmu (drive) crashed (SIGSEGV, segmentation fault)")
    assert "Traceback" not in done.stderr
    assert command.survivors() == []


def test_a_drive_that_crashes_for_want_of_its_resources_is_refused(command: Command, root: Path):
    good = root / "fmus" / "python_servo" / "python_servo.fmu"
    poor = altered(good, command.folder / "poor.fmu", lambda n, c: None if n.startswith("resources/") else (n, c))
    ran = [sys.executable, "-m", "twin", "run", str(root / EXPERIMENT), "--drive", str(poor), "--out", "x"]
    done = process_run(ran, cwd=command.folder, env=command.environment, timeout=120)
    assert done.returncode == 2
    assert done.stderr.startswith("poor.fmu")
    assert "in fmi2" in done.stderr or "fmi2Instantiate refused" in done.stderr
    assert "Traceback" not in done.stderr
    assert command.survivors() == []
