import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.studies.sweep.statistics.rows import kept, row
from twin.studies.result import TEXT_WIDTH
from twin.studies.sweep.columns import Row
from twin.studies.sweep.plan import saltelli_cube
from twin.studies.sweep.show.parts import (
    ReportPart,
    SweepQuery,
    headline,
    interval,
    number,
    parts,
    short_names,
    sweep_text,
)
from twin.studies.sweep.show.pictures import shown_range
from twin.studies.sweep.statistics.ranking import usual_against, usual_metric
from twin.studies.sweep.stored import RunMargins, SweepRows

ASKED = SweepQuery("hold_error_N", "lateral_error_mm", 5)


def metrics(error: float, lateral: float = 1.0) -> dict:
    return {"hold_error_N": error, "lateral_error_mm": lateral}


def rows_of_drives() -> list:
    rows: list[Row] = []
    for drive, offset in (("one", 0.0), ("other", 0.1)):
        for point in range(8):
            rows.append(row(len(rows) + 1, {"a.k": float(point)}, drive, **metrics(1.0 + point + offset)))
    return rows


def test_the_answer_comes_first_and_failures_are_counted_and_named():
    rows = [row(1, {"a.k": 1.0}, **metrics(0.5)), row(2, {"a.k": 2.0}, **metrics(0.4)), row(3, {"a.k": 3.0})]
    text = sweep_text(kept(rows), ASKED)
    assert text.startswith("made_up  3 runs: smallest hold_error_N 0.4 (run 2: k = 2); 1 failed")
    assert text.rstrip().endswith("run 3 failed: drive_1: it crashed")


def test_a_sweep_that_is_not_over_says_how_far_it_is():
    assert headline(kept([row(1, {}, **metrics(1.0))], runs=9), "hold_error_N").startswith("made_up  1 of 9 runs")


def part(sweep: SweepRows, key: str, asked: SweepQuery = ASKED) -> ReportPart:
    return next(one for one in parts(sweep, asked) if one.key == key)


def held(run: int, k: float, error: float, settling: float | None, overshoot: float = 0.0) -> Row:
    numbers = {"hold_settling_time_s": settling, "hold_overshoot_percent": overshoot, "felt_stiffness_N_per_m": 1e3 * k}
    return row(run, {"robot.k_s": k}, None, "done", **metrics(error), **numbers)


def test_runs_within_a_step_of_the_scale_equal_the_best_and_the_first_to_settle_comes_first():
    sweep = kept([
        held(1, 0.1, 0.2, 2.0), held(2, 0.2, 0.07, 1.30), held(3, 0.3, 0.03, 1.00), held(4, 0.4, 0.0799, 0.81, 4.0),
        held(5, 0.5, 0.075, 0.83, 1.0), held(6, 0.6, 0.0801, 0.7), held(7, 0.7, 0.04, None),
    ])  # fmt: skip
    assert "smallest hold_error_N 0.03 (run 3: k_s = 0.3), equal to 4 others within 0.05 N" in headline(sweep, ASKED.by)
    best = part(sweep, "best")
    # 0.02 s are no difference of settling times: the smaller overshoot decides
    assert [cells[0] for cells in best.rows] == ["3", "=5", "=4", "=2", "=7"]
    assert list(best.head[-3:]) == ["settles s", "overshoot %", "felt N/m"] and best.rows[-1][-3] == "-"
    assert best.remarks == (
        ["=: equal to the best within 0.05 N; ordered by settling time, then overshoot", "settles s, -: not within 5 %"]
    )
    assert part(sweep, "best", SweepQuery(ASKED.by, ASKED.against, 7)).rows[-2][0] == "6"


def test_of_many_equal_runs_twelve_are_shown_and_the_others_counted():
    best = part(kept([held(n, float(n), 0.001 * n, 1.0) for n in range(1, 41)]), "best")
    assert len(best.rows) == 12 and "(28 more not shown)" in best.remarks[0]


@pytest.mark.parametrize(("best_at", "at_the_edge"), [(1, True), (2, False), (3, False), (4, True)])
def test_the_best_at_the_end_of_a_range_is_said_to_be_at_the_edge(best_at: int, at_the_edge: bool):
    sweep = kept([held(n, float(n), 1.0 + abs(n - best_at), 1.0) for n in range(1, 5)])
    assert ("; k_s at the edge of the range tried" in headline(sweep, ASKED.by)) == at_the_edge


def test_a_run_that_failed_was_tried_and_of_two_values_none_is_an_edge():
    failed = row(5, {"robot.k_s": 0.5})
    assert "edge" not in headline(kept([*(held(n, float(n), float(n), 1.0) for n in range(1, 5)), failed]), ASKED.by)
    assert "edge" not in headline(kept([held(1, 1.0, 1.0, 1.0), held(2, 2.0, 2.0, 1.0)]), ASKED.by)


def test_rows_without_a_hold_error_show_the_error_since_the_first_touch_and_say_so():
    older = kept([row(n, {"k": float(n)}, force_error_N=float(n), lateral_error_mm=1.0) for n in range(1, 5)])
    by = usual_metric(older.columns)
    assert by == "force_error_N" and usual_against(older.columns, by) == "lateral_error_mm"
    assert "this is the error since the first touch, as no run has a hold error" in headline(older, by)


def test_the_reason_why_runs_hold_nothing_stands_once():
    reason = "the run ends before a force was held for 2 s"
    short_runs = [{**held(n, float(n), 1.0, 1.0), "no_hold": reason} for n in (4, 5)]
    for one in short_runs:
        one["metrics"]["hold_error_N"] = None
    best = part(kept([*(held(n, float(n), float(n), 1.0) for n in (1, 2, 3)), *short_runs]), "best")
    assert best.remarks == [f"2 runs without hold_error_N: {reason}"]


def run_margins(run: int, gain: float | None = None, phase: float | None = None, reason: str = "") -> RunMargins:
    return {"run": run, "gain": gain, "phase_rad": phase, "reason": reason}


def test_margins_of_the_best_runs_stand_after_them_with_the_reason_where_there_are_none():
    rows, no_loop = [held(n, float(n), float(n), 1.0) for n in range(1, 7)], "no force loop in contact"
    found = [
        run_margins(6, 2.0), run_margins(3, 129.0, math.radians(108.0)), run_margins(5, 0.5),
        run_margins(1, reason=no_loop), run_margins(2, reason=no_loop), run_margins(4, reason="unstable\x1b[2J"),
    ]  # fmt: skip
    margins = part(kept(rows, margins={str(one["run"]): one for one in found}), "margins")
    # of the five runs that are shown, in their order
    assert margins.rows == [["3", "129", "108"], ["5", "0.5", "-"]]
    assert margins.remarks[:2] == [f"none of 2 runs: {no_loop}", "none of 1 run: unstable\\x1b[2J"]
    assert "margins" not in [one.key for one in parts(kept(rows), ASKED)]


def test_no_line_is_wider_than_a_terminal_and_columns_left_out_are_counted():
    names = [f"plant.a_rather_long_name_{n}" for n in range(12)]
    rows = [row(n, {name: float(n) for name in names}, **metrics(float(n))) for n in range(1, 9)]
    text = sweep_text(kept(rows), ASKED, sensitivity=True)
    assert max(map(len, text.splitlines())) <= TEXT_WIDTH
    assert "more columns in --html)" in text


def test_drives_that_cannot_be_told_apart_are_said_to_be():
    rng = np.random.default_rng(0)
    rows = [row(n + 1, {"k": float(n // 2)}, "ab"[n % 2], **metrics(rng.normal(5.0))) for n in range(40)]
    (part,) = (part for part in parts(kept(rows), ASKED) if part.key == "drives")
    assert any(remark.startswith("not distinguished from") for remark in part.remarks)
    (part,) = (part for part in parts(kept(rows_of_drives()), ASKED) if part.key == "drives")
    assert part.rows[0][0] == "one" and not any("not distinguished" in remark for remark in part.remarks)


def test_each_drive_has_correlations_of_its_own_and_few_runs_are_warned_of():
    found = [part for part in parts(kept(rows_of_drives()), ASKED) if part.key == "correlation"]
    assert [", one" in part.title or ", other" in part.title for part in found] == [True, True]
    assert found[0].rows[0][:2] == ["k", "+1.00*"]
    assert any(remark.startswith("only 8 runs") for remark in found[0].remarks)


def test_the_text_has_correlations_only_if_they_are_asked_for():
    text, more = (sweep_text(kept(rows_of_drives()), ASKED, asked) for asked in (False, True))
    assert "rank correlation with" not in text and "rank correlation with" in more
    assert "--sensitivity" in text and "--sensitivity" not in more


def test_a_design_without_indices_says_so_in_one_sentence_and_saltellis_has_them():
    (part,) = (p for p in parts(kept(rows_of_drives()), ASKED) if "no Sobol indices" in " ".join(p.remarks))
    assert part.key == "correlation"
    cube = saltelli_cube(256, 2, np.random.default_rng(0))
    rows = [row(n, {"a": x, "b": y}, **metrics(3.0 * x + y)) for n, (x, y) in enumerate(cube, start=1)]
    found = parts(kept(rows, design="saltelli"), ASKED)
    (part,) = (p for p in found if p.key == "indices")
    # 9 parts of the variance to 1; 256 blocks know it to a few hundredths
    assert part.rows[0][0] == "a" and abs(float(part.rows[0][1]) - 0.9) < 0.1
    assert not any("no Sobol indices" in remark for p in found for remark in p.remarks)


def test_with_claims_the_answer_is_how_many_are_likely_and_no_run_is_best():
    def judged(run: int, late: bool) -> dict:
        claims = {
            "trigger_time": {"value": 5.6, "verdict": "holds"},
            "true_final": {"value": 4.0 if late else 5.0, "verdict": "fails" if late else "holds"},
        }
        return {**row(run, {"plant.eta": 0.9 + 0.01 * run}, **metrics(0.1 * run)), "claims": claims}

    rows = [*(judged(run, run > 6) for run in range(1, 9)), row(9, {"plant.eta": 1.0})]
    text = sweep_text(kept(rows), ASKED)
    assert "1 of 2 claims hold in at least 95 % of the runs; least sure: true_final" in " ".join(text.split())
    assert "best runs" not in text and "Pareto" not in text
    assert "1 of 9 runs did not end and are not judged" in text


def test_short_names_tell_parameters_apart_and_are_never_a_number_alone():
    labels = ["plant.k_s", "controller.model.k_s", "plant.zero.1", "plant.eta"]
    assert list(short_names(labels).values()) == ["plant.k_s", "model.k_s", "zero.1", "eta"]


def test_numbers_that_are_not_there_are_dashes():
    assert (number(float("nan")), number(float("inf")), number(1e-17)) == ("-", "never", "0")
    assert interval((float("nan"), 1.0)) == "-"


def test_what_is_far_out_is_clipped_and_said():
    values = [1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 90.0]
    low, high, told = shown_range(np.array(values))
    assert (low, high) == (1.0, 1.5)
    assert told == "1 of 7 are far out, 1 to 90 in all: coloured as 1 or 1.5"


def test_what_is_merely_spread_is_shown_whole():
    assert shown_range(np.array([1.0, 2.0, 4.0, 8.0])) == (1.0, 8.0, "")
    assert shown_range(np.array([])) == (0.0, 1.0, "") and shown_range(np.array([2.0, 2.0, 2.0, 9.0])) == (2.0, 9.0, "")


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40))
def test_the_range_lies_within_the_values_and_holds_at_least_half_of_them(values: list[float]):
    low, high, told = shown_range(np.array(values))
    assert min(values) <= low <= high <= max(values)
    assert 2 * sum(low <= value <= high for value in values) >= len(values)
    assert bool(told) == (low > min(values) or high < max(values))
