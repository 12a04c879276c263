from typing import Any

import pytest

from tests.laws.runs import shipped
from twin.kernel.errors import InputRefused
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.experiment.schema import Change, changeable_values, checked_changes

VALUES = shipped().values
REFERENCE = {"t_s": 8.0, "key": "controller.force.reference_N", "value": 6.0}


def checked(*tables: Any, values: Any = VALUES) -> tuple[tuple[Change, ...], list[str]]:
    mistakes: list[str] = []
    return checked_changes(DECLARED_TABLES, tables, values, 1e-3, 20.0, mistakes), mistakes


def test_a_change_is_in_ticks_and_si():
    key = "controller.force.kp_mm_per_N"
    kp = {"t_s": 2.5, "key": key, "value": 3.0}
    found, mistakes = checked(REFERENCE, kp)
    assert mistakes == []
    # the earliest first
    assert found == (Change(2500, key, 3.0, 3e-3), Change(8000, "controller.force.reference_N", 6.0, 6.0))


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"key": "controller.force.kp"}, "did you mean 'controller.force.kp_mm_per_N'?"),
        ({"value": -1.0}, "[controller.force] reference_N = -1.0: expected a number > 0"),
        ({"t_s": 20.5}, "t_s = 20.5: after the end at 20 s"),
        ({"t_s": 0.0}, "expected a number > 0"),
        ({"t_s": 1.0005}, "not a whole number of ticks"),
        ({"until_s": 3.0}, "unknown key 'until_s'"),
    ],
)
def test_a_wrong_change_is_told_with_its_number(wrong: dict, said: str):
    found, (mistake,) = checked(REFERENCE, {**REFERENCE, "t_s": 9.0, **wrong})
    assert len(found) == 1
    assert mistake.startswith("[change 2]") and said in mistake


def test_one_number_cannot_change_twice_at_once():
    _, (mistake,) = checked(REFERENCE, REFERENCE)
    assert mistake == "[change 2] changes controller.force.reference_N at 8 s a second time; remove one"


def test_what_does_not_act_cannot_change():
    values = shipped("fig4_position").values
    assert list(changeable_values(DECLARED_TABLES, values)) == ["controller.position.kp_per_s"]
    _, (mistake,) = checked(REFERENCE, values=values)
    assert "does not act in this experiment; known are controller.position.kp_per_s" in mistake


def test_an_experiment_without_a_controller_has_nothing_to_change_and_says_so():
    assert changeable_values(DECLARED_TABLES, {}) == {}
    _, (mistake,) = checked(REFERENCE, values={})
    assert "[change 1]" in mistake


def test_a_single_table_is_no_array():
    mistakes: list[str] = []
    assert checked_changes(DECLARED_TABLES, REFERENCE, VALUES, 1e-3, 20.0, mistakes) == ()
    assert mistakes == ["[change]: a single table; changes are an array of tables, write [[change]]"]


def test_every_key_is_one_of_the_shipped_experiment():
    assert list(changeable_values(DECLARED_TABLES, VALUES)) == list(DECLARED_TABLES.changeable)


def test_mistakes_of_a_change_are_told_with_the_others():
    with pytest.raises(InputRefused, match=r"(?s)has 2 mistakes.*\[change 1\] key"):
        shipped("step_force_scale", "change.1.key=controller.mode", "duration_s=-1")
