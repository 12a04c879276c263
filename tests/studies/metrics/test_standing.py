"""Verdicts on pairs of runs: floors, paired intervals, and reasons for none."""

import numpy as np
import pytest

from twin.robot.run.measures import MeasuredValue, Values, missing_measures
from twin.studies.metrics.standing import (
    MIXED_RANK,
    compare_single_runs,
    overall_ranks,
    paired_differences,
    standing,
    standing_sentence,
)


def run(**found: float | MeasuredValue) -> Values:
    values = missing_measures("not measured") | {"hold_begin": MeasuredValue(3.0), "hold_end": MeasuredValue(10.0)}
    return values | {key: one if isinstance(one, MeasuredValue) else MeasuredValue(one) for key, one in found.items()}


def test_a_difference_within_the_floor_is_the_same():
    one = run(hold_error=0.09, hold_overshoot=0.03, shaft_work=1.04)
    found = standing(one, run(hold_error=0.05, hold_overshoot=0.01, shaft_work=1.0))
    # 0.04 N, 2 % of the force, 4 % of the work, and no chatter in either
    assert found == {"hold error": 0, "overshoot": 1, "chatter": 0, "shaft work": 0}


def test_a_force_that_does_not_settle_is_worse_than_one_that_does():
    late = run(hold_error=0.2, hold_settling_time=MeasuredValue(None, "not within 5 %"))
    assert standing(late, run(hold_error=0.2, hold_settling_time=0.8))["settling time"] == 1
    assert standing(late, late)["settling time"] == 0


def test_a_load_is_not_compared_with_a_motor_torque():
    load = run(hold_error=0.1, torque=MeasuredValue(0.5, "load of the springs; these drives report no motor torque"))
    assert standing(load, run(hold_error=0.1, torque=0.1)) == {"hold error": 0, "chatter": 0}


def test_paired_runs_need_an_interval_without_zero_and_a_mean_beyond_the_floor():
    base = np.linspace(0.0, 0.3, 8)
    other = [run(hold_error=value) for value in base]
    cases = {
        0.0: base + 0.04 + 1e-4 * np.arange(8),
        1.0: base + 0.06 + 1e-4 * np.arange(8),
        -1.0: base - 0.06 - 1e-4 * np.arange(8),
        # 0.1 N in the mean, but scattered
        0.5: base + np.array([0.0, 0.8, -0.6, 0.9, -0.5, 0.7, -0.7, 0.2]),
    }
    for wanted, values in cases.items():
        (found, _) = paired_differences([run(hold_error=value) for value in values], other)
        d = values - base
        assert found.mean == pytest.approx(np.mean(d)), wanted
        assert found.half_width == pytest.approx(2.365 * np.std(d, ddof=1) / np.sqrt(8)), wanted
        assert found.rank == int(wanted), wanted
    assert found.agreeing == 4 and found.runs == 8 and abs(found.mean) > 0.05


def test_over_several_experiments_it_is_torn_where_they_disagree():
    found = overall_ranks([{"a": -1, "b": -1, "c": 1, "d": 0}, {"b": -1, "a": 1, "c": 0, "d": 0}])
    assert found == {"a": MIXED_RANK, "b": -1, "c": 1, "d": 0}
    assert standing_sentence("B", "A", found, {"b": "-1 N", "a": "0 N"}) == (
        "B beside A: better in b (-1 N); worse in c; the same in d; now better, now worse in a"
    )


def test_nothing_in_common_is_reported():
    assert standing_sentence("B", "A", {}) == "B beside A: no measure that both have"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"contact": {"stiffness": 2.0}}, "no verdict, another body"),
        ({"task": [{"force_N": 3.0}]}, "no verdict, another task"),
        ({"controller": {"mode": "force_position", "force": {"reference_N": 4.0}}}, "no verdict, another reference"),
        ({"plant": {"k_s_Nm_per_rad": 2.0}}, "the same in hold error, chatter (one run each)"),
    ],
)
def test_one_run_each_has_a_verdict_only_for_the_same_reference_task_and_body(change: dict, said: str):
    base = {"controller": {"mode": "force_position", "force": {"reference_N": 5.0}}, "contact": {"stiffness": 1.0}}
    values = run(hold_error=0.1)
    assert compare_single_runs(("B", "A"), (values, values), (base | change, base)) == f"B beside A: {said}"
