"""Tables as models read them."""

from pathlib import Path

import pytest

from twin.kernel.errors import InputRefused
from twin.kernel.settings import Settings
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.mistakes import check_table


def refusal(path: Path, *settings: str, **names: str) -> list[str]:
    with pytest.raises(InputRefused) as refused:
        load_experiment(path, settings, **names)
    return str(refused.value).splitlines()


@pytest.mark.parametrize(
    ("experiment", "settings", "said"),
    [
        ("fig4_force_position", ["robot.l_a_mm=0.06"], "[robot] l_a_mm = 0.06: 0.06 mm; did you mean 60 (mm)?"),
        ("pressing", ["plant.l_b_mm=0.1"], "[plant] l_b_mm = 0.1: 0.1 mm; did you mean 100 (mm)?"),
        ("pressing", ["plant.l_b_mm=110000"], "[plant] l_b_mm = 110000: 110000 mm; did you mean 110 (mm)?"),
        ("pressing", ["approach.height_mm=-0.09"], "[approach] height_mm = -0.09: -0.09 mm; did you mean -90 (mm)?"),
        (
            "fig4_force_position",
            ["reference.t_s=[0, 1]", "reference.p_mm=[[0, 0, -0.09], [0, 0, -0.1]]"],
            "[reference] p_mm, z of the lowest = -0.1: -0.1 mm; did you mean -100 (mm)?",
        ),
    ],
)
def test_a_length_in_metres_is_pointed_at(root: Path, experiment: str, settings: list[str], said: str):
    lines = refusal(root / "experiments" / f"{experiment}.toml", *settings)
    # before the poses that the robot cannot reach because of it
    assert lines[1].strip() == said
    assert "out of reach" in lines[-1]
    assert sum("did you mean" in line for line in lines) == 1


def test_a_robot_that_is_only_a_little_too_small_is_no_slip_of_the_unit(root: Path):
    lines = refusal(root / "experiments/fig4_force_position.toml", "robot.l_b_mm=40")
    assert len(lines) == 1 and "out of reach" in lines[0]


def test_of_a_misspelt_body_nothing_else_is_told(root: Path):
    lines = refusal(root / "experiments/pressing.toml", body="bakc")
    assert len(lines) == 1 and lines[0].endswith("no such body; did you mean 'back'?")


def test_a_misspelt_drive_is_told_with_the_nearest(root: Path):
    lines = refusal(root / "experiments/pressing.toml", drive="pmsm_fok")
    assert len(lines) == 1 and lines[0].endswith("no such drive; did you mean 'pmsm_foc'?")


class Made(Settings):
    count: int = 0
    share: float = 0.0


def test_tables_that_are_written_alike_are_one_and_others_are_not():
    mistakes: list[str] = []
    zero, same, negative = (check_table(Made, {"share": share}, "made", mistakes) for share in (0.0, 0.0, -0.0))
    assert zero is same and str(zero) != str(negative)
    # equal in Python, and to TOML a whole number, another number and a truth value
    for said in (1, 1.0, True):
        check_table(Made, {"count": said}, "made", mistakes)
    assert mistakes == [
        "[made] count = 1.0: expected a whole number",
        "[made] count = true: expected a whole number",
    ]
