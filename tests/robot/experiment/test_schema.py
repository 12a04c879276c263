"""[approach] and [[task]]: what is read, what is refused, and the program it becomes."""

import pytest

from tests.laws.runs import shipped
from twin.kernel.errors import InputRefused
from twin.robot.controller.program import TASK_KINDS, Press, Push, Roll, Tap
from twin.robot.experiment.schema import checked_tasks

PRESS = {"kind": "press", "point_mm": (0.0, 5.0), "force_N": 8.0, "build_up_s": 3.5, "hold_s": 5.0}
TAP = {
    "kind": "tap", "point_mm": (0.0, 5.0), "force_N": 3.0, "speed_mm_per_s": 50.0, "lift_mm": 8.0, "period_s": 0.5,
    "times": 10,
}  # fmt: skip
ROLL = {
    "kind": "roll", "point_mm": (0.0, 5.0), "force_N": 5.0, "build_up_s": 2.0, "radius_mm": 5.0, "rate_Hz": 0.5,
    "turns": 5,
}  # fmt: skip
PUSH = {
    "kind": "push", "point_mm": (0.0, 20.0), "force_N": 5.0, "build_up_s": 2.0, "to_mm": (0.0, -20.0),
    "speed_mm_per_s": 5.0,
}  # fmt: skip


def mistakes(*tables):
    told: list[str] = []
    checked_tasks(TASK_KINDS, tables, told)
    return told


def refusal(name, *overrides):
    with pytest.raises(InputRefused) as refused:
        shipped(name, *overrides)
    return str(refused.value)


def test_tasks_are_si_inside_and_numbered_from_1():
    told: list[str] = []
    tasks = checked_tasks(TASK_KINDS, (PRESS, TAP, ROLL, PUSH), told)
    assert told == []
    assert list(tasks) == [1, 2, 3, 4]
    press, tap, roll, push = tasks.values()
    assert isinstance(press, Press) and isinstance(tap, Tap) and isinstance(roll, Roll) and isinstance(push, Push)
    assert (press.point, press.force, press.build_up, press.hold) == ((0.0, 0.005), 8.0, 3.5, 5.0)
    assert (tap.speed, tap.lift, tap.period, tap.times) == (0.05, 0.008, 0.5, 10)
    assert (roll.radius, roll.rate, roll.turns) == (0.005, 0.5, 5.0)
    assert (push.to, push.speed) == ((0.0, -0.02), 0.005)


@pytest.mark.parametrize(
    ("table", "said"),
    [
        (PRESS | {"kind": "knead"}, "[task 1] kind = 'knead': expected 'press', 'tap', 'roll', 'push'"),
        ({key: PRESS[key] for key in PRESS if key != "kind"}, "[task 1] kind = None: expected 'press'"),
        (3, "[task 1] kind = None: expected 'press'"),
        (PRESS | {"force_N": -1.0}, "[task 1] force_N = -1.0: expected a number > 0"),
        (PRESS | {"force": 8.0}, "[task 1] unknown key 'force'; did you mean 'force_N'?"),
        (PRESS | {"point_mm": (0.0,)}, "[task 1] point_mm: [0.0] has too few values"),
        (PRESS | {"radius_mm": 5.0}, "[task 1] unknown key 'radius_mm'"),
        ({key: PRESS[key] for key in PRESS if key != "hold_s"}, "[task 1] missing key 'hold_s'"),
        (TAP | {"times": 0}, "[task 1] times = 0: expected a number >= 1"),
        (TAP | {"times": 1.5}, "[task 1] times = 1.5: expected a whole number"),
        (ROLL | {"turns": 0.5}, "[task 1] turns = 0.5: expected a number >= 1"),
        (ROLL | {"rate_Hz": float("nan")}, "[task 1] rate_Hz = nan: expected a finite number"),
        (PUSH | {"to_mm": (0.0, 20.0)}, "[task 1] to_mm is point_mm: expected another point, to which to push"),
    ],
)
def test_a_mistake_in_a_task_is_one_sentence_with_its_number(table, said):
    (told,) = mistakes(table)
    assert told.startswith(said)


def test_a_wrong_task_leaves_the_others_their_numbers():
    told: list[str] = []
    assert list(checked_tasks(TASK_KINDS, (PRESS, TAP | {"times": 0}, ROLL), told)) == [1, 3]
    assert len(told) == 1


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("task=3", "[task]: a single table; tasks are an array of tables, write [[task]]"),
        ("task=[]", "[[task]]: an empty array; expected at least one task"),
        ("approach.floor_mm=-80", "[approach] floor_mm = -80 is not below height_mm = -92"),
        ("approach.ramp_ms=0", "[approach] ramp_ms = 0: expected a number > 0"),
        ("approach.speed=3", "[approach] unknown key 'speed'; did you mean 'speed_mm_per_s'?"),
    ],
)
def test_a_mistake_in_how_tasks_are_given_is_told_once(override, said):
    told = refusal("pressing", override)
    assert told.partition(".toml: ")[2].startswith(said)


def test_a_source_may_stand_beside_any_value_of_a_task():
    origins = shipped("pressing", "task.1.point_mm=[1.0, 0.0]").origins
    assert origins["task.1.force_N"] == "assumed: a firm thumb; the paper prints no force"
    assert origins["task.1.point_mm"] == "set on the command line"


def test_one_value_of_one_task_may_be_set_on_the_command_line():
    experiment = shipped("tapping", "task.2.force_N=4", "task.2.point_mm=[1, 2]")
    assert [task.force for task in experiment.tasks] == [3.0, 4.0]
    assert [task.point for task in experiment.tasks] == [(0.0, 0.0), (0.001, 0.002)]
    assert experiment.origins["task.2.force_N"] == "set on the command line"


def test_a_file_with_tasks_keeps_none_of_those_that_it_extends():
    experiment = shipped("pressing")
    assert [task.kind for task in experiment.tasks] == ["press"]
    assert not any(key.startswith("task.2") for key in experiment.origins)


def test_the_robot_starts_at_rest_above_the_first_task():
    assert shipped("pushing").start == (0.0, 0.02, -0.092)
