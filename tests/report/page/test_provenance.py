import json
import shlex
from itertools import pairwise
from pathlib import Path

import pytest

from twin.execution import execute
from twin.experiment.experiment import load_experiment
from twin.recording.reader import read
from twin.recording.recording import Recording
from twin.report.page.provenance import command, drives
from twin.report.page.run import ReportRun


def settings_of(words: list[str]) -> list[str]:
    return [word for option, word in pairwise(words) if option == "--set"]


@pytest.mark.parametrize(
    "settings",
    [
        ["duration_s=0.1"],
        ["duration_s=0.1", "controller.force.kp_mm_per_N=3", "title=it's <b>mine</b>"],
        ["duration_s=0.1", 'fault=[{kind="drive_runaway", onset_s=0.05, magnitude_rad_per_s=2.0}]'],
    ],
)
def test_the_command_makes_the_same_recording_again(root: Path, tmp_path: Path, settings: list[str]):
    path = root / "experiments/fig4_force_position.toml"
    folders = [tmp_path / "first", tmp_path / "again"]
    for folder in folders:
        folder.mkdir()
    first = execute(load_experiment(path, settings), folders[0]).recording
    words = shlex.split(command(ReportRun("", read(first))))
    assert words[:3] == ["twin", "run", "experiments/fig4_force_position.toml"]
    again = execute(load_experiment(path, settings_of(words)), folders[1]).recording
    assert again.read_bytes() == first.read_bytes()


def test_another_drive_and_another_body_are_in_the_command(root: Path, tmp_path: Path):
    path = root / "experiments/fig4_force_position.toml"
    experiment = load_experiment(path, ["duration_s=0.1"], str(root / "fmus/pmsm_foc"), "back")
    told = command(ReportRun("", read(execute(experiment, tmp_path).recording)))
    assert "fig4_force_position.toml --drive pmsm_foc --body back --set duration_s=0.1" in told


def test_drives_that_are_alike_are_told_once_with_their_hash(force_position: Recording):
    run = ReportRun("", force_position)
    told = drives(run)
    assert told.count(run.fmus["drive_1"]["sha256"]) == 1
    assert ">1, 2, 3<" in told
    assert json.loads(force_position.metadata["fmu"]["drive_3"]) == run.fmus["drive_3"]
