"""Runs that go on from a state in their recording: same messages, same outcome; and states that are another run's."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import twin
from tests.command_line import twin as command
from twin.kernel.cosim.state import MEDIA_TYPE, SavedState
from twin.kernel.errors import InputRefused
from twin.kernel.process.states import StoredState, split_time, stored_state
from twin.kernel.recording.reader import attachments, read
from twin.robot.live.runs import load_continuation
from twin.robot.run.run import SUMMARY_FILE, execute

SHORT = ("duration_s=1.5", "recording.state_every_s=0.5")
TIMED = ("stepping", "writing", "microseconds", "real_time_factor", "simulated", "recording", "typed")
"""Of a summary what is another one in each run, or of a part."""


def made(folder: Path, experiment: str = "fig4_force_position", settings: Sequence[str] = SHORT, **more: Any) -> Path:
    return execute(twin.load(experiment, settings), folder, **more).recording


def same_from(whole: Path, part: Path) -> float:
    """Where `part` begins; it has every message of `whole` from there on, bit for bit."""
    a, b = read(whole), read(part)
    begin = float(b.time("plant")[0])
    assert b.note == "" and set(a.fields()) == set(b.fields())
    for key in a.fields():
        topic = key.rpartition(".")[0]
        ahead = a.time(topic) >= begin - 1e-9
        np.testing.assert_array_equal(a[key][ahead], b[key], err_msg=key)
        np.testing.assert_array_equal(a.time(topic)[ahead], b.time(topic))
    assert [event for event in a.events if event.time >= begin - 1e-9] == b.events
    return begin


def outcome(recording: Path) -> dict[str, Any]:
    return {k: v for k, v in json.loads((recording.parent / SUMMARY_FILE).read_text()).items() if k not in TIMED}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("experiment", "settings"),
    [
        ("fig4_force_position", ("recording.states_s=[5.601, 12]", "duration_s=13")),
        ("fig4_force_position", ("recording.states_s=[5.601]", "duration_s=7", "recording.rate=controller")),
        ("massage", ("recording.states_s=[14.003]",)),
        ("track_breathing", ("recording.states_s=[3.333]",)),
    ],
)
def test_both_parts_have_the_messages_and_the_outcome_of_the_whole(tmp_path: Path, experiment: str, settings):
    whole = made(tmp_path / "whole", experiment, [one for one in settings if "states" not in one])
    first = made(tmp_path / "first", experiment, settings)
    # that states were saved is seen in no message
    assert same_from(whole, first) == 0.0 and outcome(first) == outcome(whole)
    for time_, _ in list(attachments(first, MEDIA_TYPE))[:-1]:
        state = stored_state(first, time_)
        part = made(tmp_path / f"part {time_}", experiment, settings, state=state)
        assert time_ - 1e-9 <= same_from(whole, part) < time_ + 0.0021
        assert outcome(part) == outcome(whole)
        assert read(part).metadata["continues"] == {"run": "first", "time_s": f"{time_:.9g}"}


def test_states_are_kept_when_asked_for_and_at_the_end(tmp_path: Path):
    recording = made(tmp_path)
    assert [time_ for time_, _ in attachments(recording, MEDIA_TYPE)] == [0.5, 1.0, 1.5]
    assert read(recording).complete
    sizes = [len(content) for _, content in attachments(recording, MEDIA_TYPE)]
    assert max(sizes[:2]) < 20_000


def test_a_run_with_a_drive_without_a_state_says_so_and_runs(tmp_path: Path):
    experiment = twin.load("fig4_force_position", ("duration_s=0.2", "recording.states_s=[0.1]"), "modelica_dc")
    recording = execute(experiment, tmp_path).recording
    assert not list(attachments(recording, MEDIA_TYPE))
    (event,) = [event for event in read(recording).events if event.name == "states"]
    assert "no state is saved: modelica_dc.fmu (drive_1) has no FMU state" in event.text


def test_what_is_left_of_a_run_is_worked_out_of_its_recording(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    made(tmp_path / "run")
    experiment, state, how = load_continuation("run@0.7", ())
    assert state is not None and state.time == 0.5 and experiment.duration_ticks == 1500
    assert how == "continues from the state at 0.5 s of run"
    _, none, how = load_continuation("run@0.2", ())
    assert none is None and how == "run again from the start: run.mcap has no state at 0.2 s or before"
    later, none, how = load_continuation("run", ("duration_s=2",))
    assert none is None and later.duration_ticks == 2000
    assert how == "run again from the start: its FMUs know that it ends at 1.5 s"
    with pytest.raises(InputRefused, match=r"it ended at 1\.5 s, nothing is left to run"):
        load_continuation("run", ())
    changed = "controller.force.kp_mm_per_N=3"
    only = "with --from only duration_s can be another one; twin branch changes more"
    for settings in ((changed,), ("duration_s=2", changed)):
        with pytest.raises(InputRefused, match=only):
            load_continuation("run@1", settings)
    with pytest.raises(InputRefused, match="'soon' after the @ is not a time"):
        split_time("run@soon")


@pytest.mark.parametrize(
    ("part", "sentence"),
    [
        ("experiment", "of another experiment"),
        ("files", "of another FMU: drive_1 other, here"),
        ("code", "of another version of twin's code"),
        ("versions", "of other versions of packages: numpy 0.1, here"),
        ("processor", "of another kind of processor"),
    ],
)
def test_a_state_of_another_run_is_refused_with_what_differs(tmp_path: Path, part: str, sentence: str):
    recording = made(tmp_path / "run")
    found = stored_state(recording, 0.5)
    assert found is not None
    saved = found.saved_state
    other = {"files": {"drive_1": "other"}, "versions": {"numpy": "0.1"}}.get(part, "other")
    of = saved.about["of"] | {part: saved.about["of"][part] | other if isinstance(other, dict) else other}
    forged = SavedState(saved.tick, saved.pieces, saved.inside, saved.about | {"of": of})
    with pytest.raises(InputRefused, match=sentence):
        made(tmp_path / "part", state=StoredState(recording, 0.5, forged.to_bytes()))


@pytest.mark.parametrize("name", ["tally", "watch", "recorder", "tuning"])
def test_what_observers_found_out_is_needed(tmp_path: Path, name: str):
    recording = made(tmp_path / "run")
    saved = stored_state(recording, 0.5).saved_state  # type: ignore[union-attr]
    observers = {key: value for key, value in saved.about["observers"].items() if key != name}
    forged = SavedState(saved.tick, saved.pieces, saved.inside, saved.about | {"observers": observers})
    with pytest.raises((InputRefused, TypeError)):
        made(tmp_path / "part", state=StoredState(recording, 0.5, forged.to_bytes()))


def started(folder: Path, *settings: str) -> subprocess.Popen[str]:
    """A paced run of the massage, some of which is recorded."""
    sets = [word for one in settings for word in ("--set", one)]
    line = [sys.executable, "-m", "twin", "run", "massage", "--realtime=20", "--out", str(folder), *sets]
    process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    partial = folder / "run.mcap.partial"
    deadline = time.monotonic() + 120.0
    while not (partial.exists() and partial.stat().st_size > 400_000):
        assert process.poll() is None and time.monotonic() < deadline
        time.sleep(0.02)
    return process


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupted_run_goes_on_where_it_was(tmp_path: Path, number: int, code: int):
    process = started(tmp_path / "first")
    process.send_signal(number)
    _, said = process.communicate(timeout=60.0)
    assert process.returncode == code
    assert said.strip().endswith(f"; continue with: twin run --from {tmp_path / 'first'}")
    done = command("run", "--from", tmp_path / "first", "--out", tmp_path / "second", cwd=tmp_path)
    assert done.returncode == 0 and "continues from the state at " in done.stdout
    whole = made(tmp_path / "whole", "massage", ())
    assert 0.0 < same_from(whole, tmp_path / "second" / "run.mcap") < 60.0
    assert outcome(tmp_path / "second" / "run.mcap") == outcome(whole)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_a_run_that_is_killed_goes_on_from_its_last_state(tmp_path: Path):
    process = started(tmp_path / "first", "recording.state_every_s=0.2")
    process.send_signal(signal.SIGKILL)
    process.communicate(timeout=60.0)
    done = command("run", "--from", tmp_path / "first", "--out", tmp_path / "second", cwd=tmp_path)
    assert done.returncode == 0 and "continues from the state at " in done.stdout
    assert same_from(made(tmp_path / "whole", "massage", ()), tmp_path / "second" / "run.mcap") > 0.0


@pytest.mark.endurance
@pytest.mark.skipif(os.name != "posix", reason="signals of POSIX")
def test_whenever_a_run_is_killed_its_last_state_is_usable(tmp_path: Path):
    whole = read(made(tmp_path / "whole", "massage", ()))
    ends = {key: whole[key][-1] for key in ("plant.F_ee_B", "plant.p_B", "controller.omega_ref")}
    rng = np.random.default_rng(34)
    for number in range(50):
        first, second = tmp_path / f"{number}", tmp_path / f"{number} goes on"
        process = started(first, "recording.state_every_s=0.1")
        time.sleep(rng.uniform(0.0, 1.0))
        process.send_signal(signal.SIGKILL)
        process.communicate(timeout=60.0)
        state = stored_state(first / "run.mcap.partial", None)
        assert state is not None and state.time > 0.0
        # states are written as they come: no more than two are lost with what was not on the disk
        assert read(first, salvage=True).time("plant")[-1] < state.time + 0.2
        done = command("run", "--from", first, "--out", second, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        rest = read(second)
        for key, end in ends.items():
            np.testing.assert_array_equal(rest[key][-1], end)


@pytest.mark.slow
def test_a_run_with_isolated_drives_goes_on_without_and_the_other_way_round(tmp_path: Path):
    settings = ["--set", "duration_s=1.5", "--set", "recording.states_s=[0.5]"]
    whole = made(tmp_path / "whole", settings=("duration_s=1.5",))
    for one, other in (("drive", "run"), ("run", "drive")):
        first, second = tmp_path / f"first {one}", tmp_path / f"second {one}"
        line = ("run", "fig4_force_position", *settings, "--isolate", one, "--out", first)
        assert command(*line, cwd=tmp_path, isolated=True).returncode == 0
        line = ("run", "--from", f"{first}@0.5", "--isolate", other, "--out", second)
        assert command(*line, cwd=tmp_path, isolated=True).returncode == 0
        assert same_from(whole, second / "run.mcap") == 0.5
