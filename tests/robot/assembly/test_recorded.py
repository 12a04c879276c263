"""From a recording back to its experiment."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from tests.laws.runs import FORCE, shipped
from twin.kernel.errors import InputRefused
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import recorded_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.run import provenance


def metadata_of(experiment: Experiment) -> dict[str, dict[str, str]]:
    """What a recording of it would carry."""
    with assemble(experiment) as assembly:
        return provenance(experiment, assembly)


@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        (FORCE, ()),
        ("step_force_scale", ()),
        ("track_circle", ("plant.backlash_deg=0.05", "drive.joint_2.fmu=fmus/pmsm_foc/pmsm_foc.fmu")),
        ("massage", ()),
        ("track_breathing", ()),
    ],
)
def test_a_recording_brings_the_whole_experiment_back(name: str, overrides: tuple[str, ...], tmp_path: Path):
    experiment = shipped(name, *overrides)
    again = recorded_experiment(metadata_of(experiment), tmp_path / "run.mcap")
    body = experiment.contact.model_copy(update={"body": None})
    kept = replace(experiment, contact=body, drives=again.drives, values={}, origins={})
    assert replace(again, values={}, origins={}) == kept
    for one, other in zip(again.drives, experiment.drives, strict=True):
        assert one.sha256 and one == other.model_copy(update={"sha256": one.sha256})


def test_a_drive_that_has_become_another_file_is_refused(root: Path, tmp_path: Path):
    (tmp_path / "fmus").mkdir()
    mine = tmp_path / "fmus" / "mine.fmu"
    shutil.copy(root / "fmus/velocity_servo/velocity_servo.fmu", mine)
    metadata = metadata_of(shipped(FORCE, f"drive.fmu='{mine}'"))
    assert recorded_experiment(metadata, tmp_path / "run.mcap").drives[0].fmu == str(mine)
    shutil.copy(root / "fmus/stepper/stepper.fmu", mine)
    with pytest.raises(InputRefused, match="It is another file"):
        assemble(recorded_experiment(metadata, tmp_path / "run.mcap"))
    mine.unlink()
    place = r"is neither in fmus/ nor in the recording's folder"
    with pytest.raises(InputRefused, match=rf"run\.mcap: its drive mine\.fmu {place}"):
        recorded_experiment(metadata, tmp_path / "run.mcap")


def test_a_run_that_was_changed_by_hand_is_refused(tmp_path: Path):
    metadata = metadata_of(shipped())
    with pytest.raises(InputRefused, match="was changed by hand while it ran"):
        recorded_experiment(metadata | {"changed": {"first": "kp"}}, tmp_path / "run.mcap")


@pytest.mark.parametrize("experiment", [{}, {"name": "x", "values": "{}"}])
def test_a_recording_without_an_experiment_is_refused(experiment: dict[str, str], tmp_path: Path):
    metadata = {"experiment": experiment, "fmu": {"drive_1": json.dumps({"sha256": "0"})}}
    with pytest.raises(InputRefused, match="carries no experiment that could be run again"):
        recorded_experiment(metadata, tmp_path / "run.mcap")
