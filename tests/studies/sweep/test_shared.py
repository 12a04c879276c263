"""Runs of a sweep that share a past have the numbers of runs from the start, bit for bit."""

from collections.abc import Iterator

import pytest

from twin.robot.experiment.experiment_files import experiment_file
from twin.robot.run.runs import Runs
from twin.robot.run.shared_prefix import SharedPrefix
from twin.studies.sweep import worker
from twin.studies.sweep.worker import NUMBERS_REQUEST, RUNS_BEFORE_SHARING

PRESSING = experiment_file("pressing")
DRIFT = 'fault=[{kind = "encoder_drift", target = "motor_encoder_1", onset_s = 6.5, magnitude_deg_per_s = 2.0}]'
GLITCH = (
    'fault=[{kind = "encoder_glitch", target = "joint_encoder_2", onset_s = 5.0, magnitude_deg = 1.0, share = 0.01}]'
)
JUMP = 'fault=[{kind = "surface_jump", target = "contact", onset_s = 7.0, magnitude_mm = 1.0}]'
RUNAWAY = 'fault=[{kind = "drive_runaway", target = "drive_2", onset_s = 6.0, magnitude_rad_per_s = 1.0}]'
CHANGE = 'change=[{t_s = 6.0, key = "controller.force.kp_mm_per_N", value = 3.0}]'


@pytest.fixture(autouse=True)
def _past(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    with Runs(NUMBERS_REQUEST, RUNS_BEFORE_SHARING, most=1) as runs:
        monkeypatch.setattr(worker, "_runs", runs)
        yield


def lacking() -> str:
    (past,) = worker._runs._pasts
    assert past.shared is not None
    return past.shared.lacking


def found(settings: list[list[str]], drive: str | None = None) -> list[tuple[str, str, str]]:
    trials = [worker.trial(PRESSING, drive, one) for one in settings]
    return [(trial["status"], trial["reason"], repr(trial["metrics"])) for trial in trials]


@pytest.mark.parametrize(
    ("table", "key", "values"),
    [
        (DRIFT, "fault.1.magnitude_deg_per_s", [1.0, 2.0, 4.0, 40.0]),
        (GLITCH, "fault.1.seed", [0, 1, 2, 3]),
        (JUMP, "fault.1.magnitude_mm", [1.0, 2.0, 3.0, 10.0]),
        (RUNAWAY, "fault.1.magnitude_rad_per_s", [0.5, 1.0, 2.0, 3.0]),
        (CHANGE, "change.1.value", [0.5, 1.0, 2.0, 1000.0]),
        (CHANGE, "change.1.t_s", [0.01, 5.0, 6.0, 7.1]),
    ],
    ids=["drift", "glitch", "jump", "runaway", "change", "when"],
)
def test_runs_that_share_a_past_are_those_from_the_start(
    monkeypatch: pytest.MonkeyPatch, table: str, key: str, values: list[float]
):
    settings = [[table, f"{key}={values[0]}"]] * RUNS_BEFORE_SHARING + [[table, f"{key}={value}"] for value in values]
    shared = found(settings)
    assert lacking() == ""
    worker._runs.close()
    monkeypatch.setattr(worker, "_runs", Runs(NUMBERS_REQUEST, most=0))
    assert shared == found(settings)
    assert len(set(shared)) > 1


def test_keys_that_act_from_the_start_share_no_past(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(SharedPrefix, "__init__", lambda *_: pytest.fail("a past was made"))
    assert {status for status, *_ in found([[DRIFT, f"plant.k_s_Nm_per_rad={1.0 + 0.1 * i}"] for i in range(5)])} == {
        "done"
    }


def test_a_drive_without_a_state_runs_from_the_start():
    settings = [[CHANGE, f"change.1.value={value}"] for value in (1.0, 1.0, 1.0, 2.0)]
    shared = found(settings, "modelica_dc")
    assert "no FMU state" in lacking()
    assert shared[0] == shared[2] != shared[3]
