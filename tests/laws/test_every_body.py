"""Every body is pressed alike by the shipped robot and by a robot that works 40 mm lower."""

from functools import cache
from pathlib import Path

import pytest

from tests.laws.runs import EXPERIMENTS
from twin.kernel.errors import InputRefused
from twin.robot.assembly.load import load_experiment
from twin.robot.assembly.own_robot import start_on_robot, start_robot
from twin.robot.run.runs import Outcome, RunRequest, Runs

BODIES = sorted(path.stem for path in (EXPERIMENTS / "bodies").glob("*.toml"))
LOWER_ROBOT = """
extends = "pressing.toml"
[robot]
l_b_mm = 146.0          # the home pose of the shipped robot, 40 mm lower
[contact]
height_mm = -141.0
[approach]
height_mm = -132.0
floor_mm  = -170.0
[monitor]
z_min_mm = -175.0
z_max_mm = -115.0
"""


def pressed(file: Path, body: str) -> Outcome:
    return Runs(RunRequest(tally=True), most=0).run(load_experiment(file, body=body))


@cache
def hold_error(file: Path, body: str) -> float:
    outcome = pressed(file, body)
    assert outcome.status == "done" and outcome.trip is None and outcome.numbers is not None
    error = outcome.numbers.measures["hold_error"].value
    assert error is not None
    return error


@pytest.fixture(name="lower", params=["by hand", "by twin init"])
def experiment_on_a_lower_robot(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    file, robot = tmp_path / "lower.toml", tmp_path / "robot.toml"
    if request.param == "by hand":
        file.write_text(LOWER_ROBOT)
    else:
        start_robot(robot, ["a=50", "b=30", "l_a=60", "l_b=146"], [])
        start_on_robot(file, "pressing", robot)
    return file


@pytest.mark.parametrize("body", BODIES)
def test_a_robot_that_works_40_mm_lower_presses_every_body_as_well(lower: Path, body: str):
    assert load_experiment(lower, body=body).contact.height == -0.141
    assert hold_error(lower, body) == pytest.approx(hold_error(EXPERIMENTS / "pressing.toml", body), abs=0.05)


def test_a_body_at_the_height_of_the_shipped_robot_is_out_of_the_lower_ones_range(lower: Path):
    with pytest.raises(InputRefused, match="the surface is at z = -101"):
        load_experiment(lower, ["contact.height_mm=-101"], body="back")
