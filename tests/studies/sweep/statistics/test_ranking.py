"""Which runs are best, and by which metrics one can say so."""

import math
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.studies.sweep.statistics.rows import kept, row
from twin.kernel.errors import InputRefused
from twin.studies.sweep.claims import pack_curves
from twin.studies.sweep.columns import Columns, Row, columns_of
from twin.studies.sweep.measures import meets_limits
from twin.studies.sweep.show.parts import SweepQuery, parts
from twin.studies.sweep.statistics.ranking import (
    HISTOGRAM_BINS,
    METRIC_DECIMALS,
    bands,
    claims_in,
    drive_ranking,
    likelihoods,
    metric_spread,
    metrics_in,
    pareto_front,
    ranked_rows,
    require_rank,
    round_metrics,
    usual_metric,
    value,
    worst_over,
)


def judged(run: int, value: float | None, verdict: str) -> dict:
    return {**row(run, {}, y=1.0), "claims": {"trigger_time": {"value": value, "verdict": verdict}}}


def test_only_judged_runs_count_and_the_trivial_and_the_failed_are_told_apart():
    rows = [
        judged(1, 5.6, "holds"),
        judged(2, 5.5, "holds"),
        judged(3, 4.0, "fails"),
        judged(4, 5.6, "trivial"),
        row(5, {}),
    ]
    (found,) = likelihoods(columns_of(rows))
    assert (found.holds, found.judged, found.trivial) == (2, 3, 1)
    assert found.share == pytest.approx(2 / 3)
    assert found.interval[0] < 2 / 3 < found.interval[1]


def test_what_never_happens_is_infinitely_late():
    (found,) = likelihoods(columns_of([judged(1, None, "fails"), judged(2, 5.6, "holds"), judged(3, 5.7, "holds")]))
    assert found.quantiles[-1] == math.inf and found.quantiles[2] == 5.7


def test_a_claim_that_is_always_trivial_has_no_probability():
    (found,) = likelihoods(columns_of([judged(1, 0.0, "trivial")]))
    assert math.isnan(found.share) and found.interval == (0.0, 1.0)


def test_a_claim_that_holds_in_all_of_a_few_runs_is_no_certainty():
    (found,) = likelihoods(columns_of([judged(number, 5.6, "holds") for number in range(20)]))
    # 20 of 20: Wilson's lower end is 1 / (1 + 1.96^2 / 20)
    assert found.interval == pytest.approx((1.0 / (1.0 + 1.959964**2 / 20), 1.0), abs=1e-6)


def test_bands_are_quantiles_over_runs_at_each_time():
    t = np.array([0.0, 0.4])
    rows = [{**row(n, {}, y=1.0), "curves": pack_curves({"a": (t, float(n) + t)}, 0.4)} for n in range(1, 102)]
    found = bands([*rows, row(200, {})])
    assert found is not None and found.runs == 101
    # 1 to 101 plus the time: quantiles at 5, 25, 50, 75 and 95 % are runs; 32 bit floats
    assert found["a"] == pytest.approx(np.array([6, 26, 51, 76, 96])[:, None] + found.t, abs=1e-5)


def test_without_claims_there_are_no_likelihoods_and_no_bands():
    assert likelihoods(columns_of([row(1, {}, y=1.0)])) == [] and bands([row(1, {}, y=1.0)]) is None


def test_of_a_draw_it_counts_whether_a_claim_holds_and_not_whether_that_was_known():
    rows = [judged(n, 5.6, verdict) for n, verdict in enumerate(("holds", "reproduced after all", "not reproduced"), 1)]
    (found,) = likelihoods(columns_of([*rows, judged(4, 4.0, "fails")]))
    assert (found.holds, found.judged, found.trivial) == (2, 4, 0)


KNOWN = ("force_error_N", "peak_N", "end_N", "press.mean", "press.std")


def test_runs_that_tripped_failed_or_passed_a_limit_are_not_among_the_best():
    rows = [row(1, {}, y=3.0), row(2, {}, status="tripped", y=1.0), row(3, {}), {**row(4, {}, y=0.5)}]
    rows[3]["within_limits"] = False
    assert ranked_rows(columns_of(rows), "y").tolist() == [0]


@pytest.mark.parametrize("metric", ["end_N", "press.mean"])
def test_a_metric_of_which_less_is_not_better_ranks_nothing(metric: str):
    with pytest.raises(InputRefused, match=r"is not better; rank by force_error_N, peak_N, press\.std$"):
        require_rank("--by", metric, KNOWN)


def test_a_misspelt_metric_is_corrected():
    with pytest.raises(InputRefused, match="did you mean 'peak_N"):
        require_rank("--by", "peek_N", KNOWN)


def test_a_claims_number_may_be_asked_for_where_claims_were_judged():
    claims = {"true_final": {"value": 4.9, "verdict": "holds"}}
    judged = columns_of([{**row(1, {}, y=1.0), "claims": claims}, row(2, {}, true_final=7.0)])
    assert claims_in(judged) == ["true_final"]
    assert require_rank("--by", "true_final", KNOWN, claims_in(judged)) == "true_final"
    assert value(judged, "true_final").tolist() == [4.9, 7.0]


def test_metrics_of_every_sweep_come_before_those_of_measures():
    rows = [{**row(1, {}, y=1.0), "metrics": {"press.std": 1.0, "peak_N": 2.0, "force_error_N": None}}]
    assert metrics_in(columns_of(rows)) == ["peak_N", "press.std"]


def test_without_a_controlled_force_runs_are_ranked_by_position():
    uncontrolled = columns_of([row(1, {}, force_error_N=None, lateral_error_mm=1.0)])
    assert usual_metric(uncontrolled) == "lateral_error_mm"
    assert usual_metric(columns_of([row(1, {}, force_error_N=1.0)])) == "force_error_N"
    assert usual_metric(columns_of([row(1, {}, force_error_N=1.0, hold_error_N=2.0)])) == "hold_error_N"
    assert usual_metric(columns_of([])) == "hold_error_N"


def test_a_held_force_without_chatter_is_better_than_any_that_has_some_and_keeps_every_limit():
    rows = [row(1, {}, hold_error_N=1.0, chatter_N=0.2), row(2, {}, hold_error_N=1.0, chatter_N=None)]
    rows.append(row(3, {}, hold_error_N=None, chatter_N=None))
    assert ranked_rows(columns_of(rows), "chatter_N").tolist() == [1, 0]
    assert [meets_limits(one["metrics"], {"chatter_N": 0.1}) for one in rows] == [False, True, False]


def test_rounding_makes_no_run_better():
    # 1e-17 mm is what a symmetric run is off sideways
    columns = columns_of([row(1, {}, y=1e-17), row(2, {}, y=0.0), row(3, {}, y=1e-9)])
    assert ranked_rows(columns, "y").tolist() == [0, 1, 2]
    assert value(columns, "y")[2] == 1e-9


NUMBERS = st.one_of(
    st.floats(allow_nan=False, allow_infinity=False), st.integers(-(10**16), 10**16).map(lambda n: n / 2e12)
)


@given(st.lists(NUMBERS, max_size=50))
@example([0.5e-12, 1.5e-12, 2.5e-12, 4096.0000000000005, 8191.9999999999995, -0.0])
def test_columns_are_rounded_as_python_rounds_a_number(numbers: list[float]):
    assert round_metrics(np.array(numbers, float)).tolist() == [round(number, METRIC_DECIMALS) for number in numbers]


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=30), st.integers(0, 3))
@example([0.0, 1.5e-247], 0)
@example([1000.0, math.nextafter(1000.0, math.inf)], 0)
@example([0.0, 5e-12], 0)
def test_every_run_is_in_a_bin_or_counted_as_missing(numbers: list[float], failed: int):
    rows = [row(n, {}, y=number) for n, number in enumerate(numbers)] + [row(100 + n, {}) for n in range(failed)]
    found = metric_spread(columns_of(rows), "y")
    assert found is not None
    assert sum(found.counts) == len(numbers) and found.missing == failed
    # a metric has 12 decimals, and a double near 1,000 as many
    if (range_ := float(np.ptp(numbers))) > 3e-12 * max(1.0, *np.abs(numbers)):
        assert len(found.counts) == HISTOGRAM_BINS
        # each number and each edge is off by a rounding
        assert found.edges[-1] - found.edges[0] == pytest.approx(range_, abs=2e-12)
    elif range_ < 1e-13:
        assert len(found.counts) == 1
    assert found.edges[0] <= found.numbers.min() and found.numbers.max() <= found.edges[-1]
    np.testing.assert_allclose(np.diff(found.edges), np.diff(found.edges)[0], rtol=1e-9, atol=1e-12)
    assert list(found.quantiles) == sorted(found.quantiles)


def test_a_metric_that_no_run_has_is_not_spread():
    assert metric_spread(columns_of([row(1, {})]), "y") is None


PAIRS = st.lists(st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=1, max_size=25)


@given(PAIRS)
def test_a_run_is_on_the_front_if_and_only_if_no_other_beats_it(pairs: list[tuple[int, int]]):
    rows = [row(number, {}, y=float(y), z=float(z)) for number, (y, z) in enumerate(pairs, start=1)]
    beaten = {
        number
        for number, (y, z) in enumerate(pairs, start=1)
        if any(a <= y and b <= z and (a, b) != (y, z) for a, b in pairs)
    }
    columns = columns_of(rows)
    front = pareto_front(columns, "y", "z")
    assert {columns.run_number(row) for row in front} == set(range(1, len(pairs) + 1)) - beaten
    assert (np.diff(value(columns, "y")[front]) >= 0.0).all()


def test_runs_without_one_of_the_metrics_are_on_no_front():
    columns = columns_of([row(1, {}, y=1.0), row(2, {}, y=2.0, z=1.0), row(3, {})])
    assert pareto_front(columns, "y", "z").tolist() == [1]


SPRINGS, TISSUES, DRIVES = (300.0, 600.0, 900.0), ("back", "belly", "skin"), ("a", "b")
POINTS = list(product(SPRINGS, TISSUES, DRIVES))
LABELS = ("plant.k_s", "contact.body")


@given(st.lists(st.none() | st.floats(0.0, 9.0), min_size=len(POINTS), max_size=len(POINTS)))
def test_each_choice_counts_with_its_worst_run_and_a_failure_is_worse_than_any(errors: list[float | None]):
    metrics: list[dict[str, Any]] = [{} if error is None else {"force_error_N": error} for error in errors]
    rows = [
        row(n, {LABELS[0]: k, LABELS[1]: body}, drive, **of_run)
        for n, ((k, body, drive), of_run) in enumerate(zip(POINTS, metrics, strict=True), start=1)
    ]
    numbers = [float("inf") if error is None else round(error, 12) for error in errors]
    of = dict(zip(POINTS, numbers, strict=True))
    found = worst_over(kept(rows).columns, "force_error_N", LABELS[1], LABELS)
    expected = {(k, drive): max(of[k, body, drive] for body in TISSUES) for k in SPRINGS for drive in DRIVES}
    at = [POINTS[one.row] for one in found]
    assert {(k, drive): one.metric for (k, _, drive), one in zip(at, found, strict=True)} == expected
    assert [one.metric for one in found] == sorted(expected.values())
    assert all(of[point] == one.metric and one.runs == len(TISSUES) for point, one in zip(at, found, strict=True))
    assert sum(one.bad for one in found) == errors.count(None)


def test_it_is_the_first_table_and_says_on_which_tissue():
    errors = {(300.0, "back"): 0.1, (300.0, "belly"): 0.9, (600.0, "back"): 0.4, (600.0, "belly"): 0.3}
    rows = [
        row(n, dict(zip(LABELS, point, strict=True)), force_error_N=error, lateral_error_mm=1.0)
        for n, (point, error) in enumerate(errors.items(), start=1)
    ]
    part = parts(kept(rows), SweepQuery("force_error_N", "lateral_error_mm", 5, LABELS[1]))[0]
    assert part.title == "worst force_error_N over body, least worst first"
    assert part.head == ["k_s", "worst force_error_N", "at body", "runs", "failed"]
    assert part.rows == [["600", "0.4", "back", "2", "-"], ["300", "0.9", "belly", "2", "-"]]


def rows_of(values: dict[str, list[float | None]]) -> Columns:
    rows: list[Row] = []
    for drive, numbers in values.items():
        for point, number in enumerate(numbers):
            metrics: dict[str, Any] = {} if number is None else {"y": number}
            rows.append(row(len(rows) + 1, {"a": float(point)}, drive, **metrics))
    return columns_of(rows)


def test_a_small_difference_at_every_point_is_told_from_a_large_spread_over_points():
    points = np.random.default_rng(0).uniform(1.0, 10.0, 40)
    noise = np.random.default_rng(1).normal(0.0, 0.02, 40)
    first, second = drive_ranking(rows_of({"b": list(points + 0.1 + noise), "a": list(points)}), "y")
    assert (first.drive, second.drive) == ("a", "b")
    # the median of 40 differences of 0.1 that scatter by 0.02
    assert second.behind == pytest.approx(0.1, abs=0.02) and second.distinguishable
    assert math.isnan(first.behind)


def test_drives_that_differ_by_chance_only_are_not_told_apart():
    rng = np.random.default_rng(3)
    first, second = drive_ranking(rows_of({d: list(rng.normal(5.0, 1.0, 30)) for d in "ab"}), "y")
    assert not second.distinguishable
    assert first.best + second.best == pytest.approx(1.0) and second.best > 0.02


def test_equal_drives_share_the_first_place():
    values: list[float | None] = [1.0, 2.0, 3.0]
    scores = drive_ranking(rows_of({"a": values, "b": values}), "y")
    assert [score.best for score in scores] == [0.5, 0.5]
    assert scores[1].behind_interval == (0.0, 0.0) and not scores[1].distinguishable


def test_who_fails_ranks_below_who_is_slow_and_nothing_of_it_vanishes():
    scores = drive_ranking(rows_of({"fragile": [0.1, None, 0.1, None], "slow": [5.0, 5.0, 5.0, 5.0]}), "y")
    assert [score.drive for score in scores] == ["slow", "fragile"]
    assert [(score.completed, score.runs) for score in scores] == [(4, 4), (2, 4)]
    # it ranks first only if no draw of four points meets one where it failed: 1 in 16
    assert scores[1].best == pytest.approx(1 / 16, abs=0.02)
    assert scores[1].behind == pytest.approx(-4.9)


def test_points_that_one_drive_has_not_run_yet_are_not_resampled():
    scores = drive_ranking(rows_of({"a": [2.0, 2.0, 0.0], "b": [1.0, 1.0]}), "y")
    assert {score.drive: score.best for score in scores} == {"a": 0.0, "b": 1.0}


def test_the_same_rows_give_the_same_intervals():
    values: dict[str, list[float | None]] = {d: list(np.random.default_rng(ord(d)).normal(5.0, 1.0, 20)) for d in "abc"}
    assert repr(drive_ranking(rows_of(values), "y")) == repr(drive_ranking(rows_of(values), "y"))


def test_drives_without_any_number_are_ranked_last_with_no_number():
    scores = drive_ranking(rows_of({"dead": [None, None], "alive": [1.0, 2.0]}), "y")
    assert scores[1].drive == "dead" and math.isnan(scores[1].median) and math.isnan(scores[1].behind)
    assert drive_ranking(rows_of({"dead": [None], "too": [None]}), "y")[0].completed == 0


def test_what_the_points_are_changes_no_number():
    values = {d: np.random.default_rng(ord(d)).normal(5.0, 1.0, 20) for d in "ab"}
    found = [
        drive_ranking(
            columns_of([
                row(n, {"a": name(float(point)), "b": point % 2 > 0}, drive, y=float(number))
                for drive, numbers in values.items()
                for n, (point, number) in enumerate(enumerate(numbers), start=1)
            ]),
            "y",
        )
        for name in (float, float.__neg__, str)
    ]  # fmt: skip
    assert repr(found[0]) == repr(found[1]) == repr(found[2])
