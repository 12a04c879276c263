"""Why `xl330` is not for massage: docs/safety.md has these numbers."""

from collections import Counter
from pathlib import Path

import pytest

from tests.laws.runs import EXPERIMENTS
from tests.laws.test_no_false_trips import DRAWN, healthy
from twin.robot.assembly.load import load_experiment
from twin.robot.monitor.reasons import Reason
from twin.robot.run.runs import Outcome, RunRequest, Runs

DRIVE = "xl330"


def drawn(draw: int) -> tuple[str, Outcome] | None:
    """Return the task and the outcome of a drawn healthy run; None if another drive is drawn."""
    run = healthy(draw)
    return None if run.drive != DRIVE else (run.task, Runs(RunRequest(), most=0).run(run.experiment))


def test_the_page_says_that_it_is_not_for_massage(root: Path):
    page = " ".join((root / "docs" / "safety.md").read_text().split())
    assert f"`{DRIVE}` is not for massage" in page
    assert "0.34 N rms in the hold of pressing.toml, 8 N" in page
    assert "trips in 26 of 80 (`HIDDEN_FORCE` 22, `FROZEN_MOTOR` 3, `FOLLOW` 1)" in page
    assert (
        f"[not for massage](safety.md#encoders-that-drift-together): `{DRIVE}`"
        in (root / "docs" / "drives.md").read_text()
    )


def test_it_hunts_while_it_holds_a_force():
    outcome = Runs(RunRequest(tally=True), most=0).run(load_experiment(EXPERIMENTS / "pressing.toml", (), DRIVE))
    assert outcome.status == "done" and outcome.numbers is not None
    # another processor may round what its friction makes of it
    assert outcome.numbers.measures["hold_error"].value == pytest.approx(0.34, abs=0.01)


def test_a_healthy_one_trips_by_a_hidden_force():
    task, outcome = drawn(6) or ("", None)
    assert task == "rolling" and outcome is not None and outcome.trip is not None
    assert outcome.trip.reason is Reason.HIDDEN_FORCE


@pytest.mark.endurance
def test_of_the_drawn_healthy_runs_a_third_trips_and_none_of_pressing():
    found = [one for draw in range(DRAWN) if (one := drawn(draw))]
    trips = [(task, outcome.trip.reason.name) for task, outcome in found if outcome.trip]
    assert len(found) == 80 and Counter(reason for _, reason in trips) == {
        "HIDDEN_FORCE": 22, "FROZEN_MOTOR": 3, "FOLLOW": 1,
    }  # fmt: skip
    assert {task for task, _ in trips} == {"tapping", "rolling", "pushing", "massage"}
