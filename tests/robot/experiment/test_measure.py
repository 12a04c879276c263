from typing import Any

import pytest

from twin.robot.experiment.measure import MEASURE_KINDS, Measure, Step, checked_measures

STEP = {"kind": "step", "name": "z", "signal": "plant.p_B[2]", "reference": "controller.p_ref_B[2]", "begin_s": 0.5}


def checked(*tables: Any) -> tuple[tuple[Measure, ...], list[str]]:
    mistakes: list[str] = []
    return checked_measures(tables, 4.0, mistakes), mistakes


def test_a_measure_is_read():
    (step,), mistakes = checked(STEP)
    assert mistakes == []
    assert isinstance(step, Step)
    assert (step.signal, step.reference, step.begin, step.until) == ("plant.p_B[2]", "controller.p_ref_B[2]", 0.5, None)


@pytest.mark.parametrize("kind", MEASURE_KINDS)
def test_every_kind_is_read(kind: str):
    fields = MEASURE_KINDS[kind].model_fields
    told = STEP | {"formula": "always (plant.p_B[2] <= 0 mm)"}
    _, mistakes = checked(
        {key: told[key] for key in ("name", "signal", "reference", "formula") if key in fields} | {"kind": kind}
    )
    assert mistakes == []


def test_a_formula_that_is_none_is_told_with_where():
    _, (mistake,) = checked({"kind": "requirement", "name": "low", "formula": "always (plant.z <= 3 Newton)"})
    assert mistake.startswith("[measure 1] formula = ")
    assert "unit 'Newton': no such unit; expected one such as N, mm" in mistake


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"kind": "steps"}, "kind = 'steps': expected 'step', 'tracking'"),
        ({"name": "Z axis"}, "expected small letters, digits and _"),
        ({"signal": "p_B"}, "expected a recorded signal such as plant.p_B[2]"),
        ({"reference": "plant p_B"}, "expected a recorded signal"),
        ({"until_s": 5.0}, "until_s = 5: after the end at 4 s"),
        ({"begin_s": 4.0}, "begin_s = 4: expected a time before 4 s"),
        ({"at_s": 1.0}, "unknown key 'at_s'"),
        ({"kind": "lag"}, "longest_s = 2: 3.5 s are too short for such lags"),
    ],
)
def test_a_wrong_measure_is_told_with_its_number(wrong: dict, said: str):
    _, mistakes = checked({**STEP, "name": "first"}, {**STEP, **wrong})
    assert len(mistakes) == 1
    assert mistakes[0].startswith("[measure 2]") and said in mistakes[0]


def test_two_measures_need_two_names():
    _, mistakes = checked(STEP, STEP)
    assert mistakes == ['[measure 2] name = "z": another measure has that name']


def test_a_single_table_is_no_array():
    mistakes: list[str] = []
    assert checked_measures(STEP, 4.0, mistakes) == ()
    assert "write [[measure]]" in mistakes[0]
