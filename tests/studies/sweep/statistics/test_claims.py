"""How likely claims are, and the bands of the curves."""

import math

import numpy as np
import pytest

from tests.studies.sweep.statistics.rows import row
from twin.studies.sweep.fig4 import packed
from twin.studies.sweep.rows import columns_of
from twin.studies.sweep.statistics.claims import bands, likelihoods


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
    rows = [{**row(n, {}, y=1.0), "curves": packed({"a": (t, float(n) + t)}, 0.4)} for n in range(1, 102)]
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
