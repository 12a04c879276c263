"""Which runs are best, and by which metrics one can say so."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.studies.sweep.statistics.rows import row
from twin.errors import InputRefused
from twin.studies.sweep.columns import columns_of
from twin.studies.sweep.statistics.ranking import (
    ROUNDING,
    best,
    checked_rank,
    claims_in,
    metrics_in,
    rounded,
    usual_metric,
    value,
)

KNOWN = ("force_error_N", "peak_N", "end_N", "press.mean", "press.std")


def test_runs_that_tripped_failed_or_passed_a_limit_are_not_among_the_best():
    rows = [row(1, {}, y=3.0), row(2, {}, status="tripped", y=1.0), row(3, {}), {**row(4, {}, y=0.5)}]
    rows[3]["within_limits"] = False
    assert best(columns_of(rows), "y").tolist() == [0]


@pytest.mark.parametrize("metric", ["end_N", "press.mean"])
def test_a_metric_of_which_less_is_not_better_ranks_nothing(metric: str):
    with pytest.raises(InputRefused, match=r"neither better nor worse; rank by force_error_N, peak_N, press\.std$"):
        checked_rank("--by", metric, KNOWN)


def test_a_misspelt_metric_is_corrected():
    with pytest.raises(InputRefused, match="did you mean 'peak_N"):
        checked_rank("--by", "peek_N", KNOWN)


def test_a_claims_number_may_be_asked_for_where_claims_were_judged():
    claims = {"true_final": {"value": 4.9, "verdict": "holds"}}
    judged = columns_of([{**row(1, {}, y=1.0), "claims": claims}, row(2, {}, true_final=7.0)])
    assert claims_in(judged) == ["true_final"]
    assert checked_rank("--by", "true_final", KNOWN, claims_in(judged)) == "true_final"
    assert value(judged, "true_final").tolist() == [4.9, 7.0]


def test_metrics_of_every_sweep_come_before_those_of_measures():
    rows = [{**row(1, {}, y=1.0), "metrics": {"press.std": 1.0, "peak_N": 2.0, "force_error_N": None}}]
    assert metrics_in(columns_of(rows)) == ["peak_N", "press.std"]


def test_without_a_controlled_force_runs_are_ranked_by_position():
    uncontrolled = columns_of([row(1, {}, force_error_N=None, lateral_error_mm=1.0)])
    assert usual_metric(uncontrolled) == "lateral_error_mm"
    assert usual_metric(columns_of([row(1, {}, force_error_N=1.0)])) == usual_metric(columns_of([])) == "force_error_N"


def test_rounding_makes_no_run_better():
    # 1e-17 mm is what a symmetric run is off sideways
    columns = columns_of([row(1, {}, y=1e-17), row(2, {}, y=0.0), row(3, {}, y=1e-9)])
    assert best(columns, "y").tolist() == [0, 1, 2]
    assert value(columns, "y")[2] == 1e-9


NUMBERS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False), st.integers(-(10**16), 10**16).map(lambda n: n / 2e12)
)


@given(st.lists(NUMBERS, max_size=50))
@example([0.5e-12, 1.5e-12, 2.5e-12, 4096.0000000000005, 8191.9999999999995, -0.0])
def test_columns_are_rounded_as_python_rounds_a_number(numbers: list[float]):
    assert rounded(np.array(numbers, float)).tolist() == [round(number, ROUNDING) for number in numbers]
