"""What version 1.0 wrote and read is read by every later 1.x: see docs/stability.md.

The files of `v1_0/` are as version 1.0 made them. They are never made again: a test that fails here says that a change
belongs into version 2.
"""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.cli.commands import COMMANDS
from tests.command_line import twin
from twin.cli.app import parameters
from twin.kernel import errors
from twin.kernel.recording.reader import read
from twin.robot.assembly.load import load_experiment
from twin.robot.run.run import without_folders
from twin.robot.run.trace import run_in_memory

RELEASED = Path(__file__).parent / "v1_0"


def missing(then: Any, now: Any, where: str = "") -> list[str]:
    """What is not `now` as it was `then`; keys that have come since are no difference."""
    if isinstance(then, dict) and isinstance(now, dict):
        return [line for key in then for line in missing(then[key], now.get(key), f"{where}.{key}".lstrip("."))]
    if isinstance(then, list) and isinstance(now, (list, tuple)) and len(then) == len(now):
        return [line for i, (a, b) in enumerate(zip(then, now, strict=True)) for line in missing(a, b, f"{where}.{i}")]
    return [] if then == now else [f"{where}: {then!r}, now {now!r}"]


def test_every_value_of_an_experiment_is_read_as_it_was():
    then = json.loads((RELEASED / "press.json").read_text())
    assert missing(then, without_folders(load_experiment(RELEASED / "press.toml").values)) == []


def test_a_value_that_is_read_otherwise_is_noticed():
    then = json.loads((RELEASED / "press.json").read_text())
    now = without_folders(load_experiment(RELEASED / "press.toml", ["controller.force.kp_mm_per_N=2"]).values)
    assert missing(then, now) == ["controller.force.kp_mm_per_N: 1.0, now 2"]


def test_a_recording_is_read():
    run = read(RELEASED / "run.mcap")
    assert run.complete
    assert run.metadata["versions"]["twin"] == "1.0.0"
    assert [event.name for event in run.events] == ["fault_1"]
    np.testing.assert_array_equal(run["encoder.count_m"][-1], [503, -80, -80])
    assert run.time("plant")[-1] == 1.0


def test_a_run_of_today_records_the_signals_of_then_under_their_names():
    then = read(RELEASED / "run.mcap")
    recorded = {key: (field.unit, then[key].shape[1:]) for key, field in then.fields().items()}
    settings = ["duration_s=0.1", "monitor={}", 'fault=[{kind="encoder_drift", target="joint_encoder_2", '
                "onset_s=0.05, magnitude_deg_per_s=0.1}]"]  # fmt: skip
    now = run_in_memory(load_experiment("fig4_force_position", settings))
    assert missing(recorded, {key: (field.unit, now[key].shape[1:]) for key, field in now.fields().items()}) == []


@pytest.mark.slow
def test_commands_take_a_recording_of_then(tmp_path: Path):
    recording = str(RELEASED / "run.mcap")
    assert twin("compare", recording, recording, "--out", str(tmp_path / "c"), cwd=tmp_path).returncode == 0
    assert twin("export", recording, "--csv", "--out", str(tmp_path / "e"), cwd=tmp_path).returncode == 0
    assert twin("report", recording, "--out", str(tmp_path / "report.html"), cwd=tmp_path).returncode == 0


def options() -> dict[str, list[str]]:
    """Every command's options and arguments as they are called."""
    return {
        words: sorted({name for p in parameters(command.function) for name in p.opts})
        for words, command in COMMANDS.items()
    }


def test_commands_and_their_options_are_still_there():
    then, now = json.loads((RELEASED / "commands.json").read_text()), options()
    assert [
        f"{words} {name}" for words, names in then.items() for name in names if name not in now.get(words, ())
    ] == []


def test_exit_codes_are_those_of_then():
    codes = {kind.__name__: kind.exit_code for kind in vars(errors).values() if hasattr(kind, "exit_code")}
    then = {"InputRefused": 2, "ComponentFailed": 3, "SafetyTrip": 4}
    assert then.items() <= codes.items()
