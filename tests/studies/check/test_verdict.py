"""What is called worse, better or other, and what is told besides."""

from dataclasses import replace

import numpy as np
import pytest

from tests.laws.runs import shipped
from tests.studies.check.traces import EXPERIMENT, t
from twin.studies.check.baseline import Baseline, Entry, baseline_of
from twin.studies.check.measurement import Measured, Sampled
from twin.studies.check.metric import Metric, Sense
from twin.studies.check.verdict import CheckVerdict, verdict

SINE = np.sin(t)


def coming_to(value: float, sense: Sense = "less", curve: np.ndarray = SINE, unit: str = "s") -> Measured:
    sampled = Sampled("plant.p_B[2]", "m", t, curve, 0.05, 0.004)
    return Measured({"z.number": Metric(value, unit, 0.0, sense)}, {"z": sampled}, {"x.fmu": "0" * 64})


def baseline(value: float = 1.0, sense: Sense = "less") -> Baseline:
    return baseline_of(EXPERIMENT, "x", coming_to(value, sense), [Entry(date="2026-01-01", reason="first")], None)


def words(found: CheckVerdict) -> list[str]:
    return [row.word for row in found.rows]


def test_the_same_run_is_ok():
    assert words(verdict(EXPERIMENT, "x", baseline(), coming_to(1.0))) == ["ok", "ok"]


@pytest.mark.parametrize(
    ("before", "now", "sense", "word"),
    [
        (1.0, 1.019, "less", "ok"),
        (1.0, 1.021, "less", "worse"),
        (1.0, 0.979, "less", "better"),
        (1.0, 1.1, "none", "moved"),
        (-1.0, -0.9, "nearer zero", "better"),
        (-1.0, -1.1, "nearer zero", "worse"),
        (1.0, np.nan, "less", "worse"),
    ],
)
def test_beyond_its_bound_a_number_is_worse_or_better(before: float, now: float, sense: Sense, word: str):
    assert words(verdict(EXPERIMENT, "x", baseline(before, sense), coming_to(now, sense)))[0] == word


@pytest.mark.parametrize(
    ("curve", "word"),
    [
        (np.sin(t) + 0.049, "ok"),
        (np.sin(t) + 0.052, "outside"),
        (np.where(t > 9.0, np.nan, np.sin(t)), "outside"),
    ],
)
def test_a_curve_that_leaves_its_tube_is_outside(curve: np.ndarray, word: str):
    found = verdict(EXPERIMENT, "x", baseline(), coming_to(1.0, curve=curve))
    assert words(found)[1] == word
    assert [beside.name for beside in found.outside] == ["z.tube"] * (word == "outside")


def test_of_a_curve_outside_there_is_what_a_picture_needs():
    (beside,) = verdict(EXPERIMENT, "x", baseline(), coming_to(1.0, curve=SINE + 0.06)).outside
    lower, before, upper, now = map(np.array, (beside.lower, beside.before, beside.upper, beside.now))
    assert (beside.signal, beside.unit, len(beside.t)) == ("plant.p_B[2]", "m", 40)
    # the tolerance, and 4 ms of a slope of at most 1; six digits are kept
    assert np.all((before - lower > 0.05 - 1e-5) & (before - lower < 0.0541) & (upper - before < 0.0541))
    assert now - before == pytest.approx(0.06, abs=1e-5)


def test_what_has_no_baseline_counts_as_what_has_one():
    now = coming_to(1.0)
    first, later = (verdict(EXPERIMENT, "x", kept, now) for kept in (None, baseline()))
    assert [row.name for row in first.rows] == [row.name for row in later.rows] and set(words(first)) == {"new"}


def test_what_is_only_in_one_of_them_deviates():
    stored = baseline()
    now = replace(coming_to(1.0), metrics={"z.other": Metric(1.0, "s", 0.0)}, curves={})
    assert words(verdict(EXPERIMENT, "x", stored, now)) == ["gone", "new", "gone"]


def test_another_fmu_another_experiment_and_another_version_are_told_and_compared_all_the_same():
    stored = baseline().model_copy(update={"twin": "0.0.1"})
    other = replace(coming_to(1.0), fmus={"x.fmu": "1" * 64})
    found = verdict(shipped("step_z_air", "controller.position.kp_per_s=2"), "x", stored, other)
    assert found.deviations == ()
    assert len(found.notes) == 3
    assert "x.fmu has changed: was sha256 000000000000, now 111111111111" in found.notes


def test_a_number_in_another_unit_is_another_number_and_that_is_told():
    found = verdict(EXPERIMENT, "x", baseline(), coming_to(1.0, unit="m"))
    assert [(row.word, row.unit) for row in found.deviations] == [("gone", "s"), ("new", "m")]
    assert found.notes == ("z.number was in s and is in m: another quantity, not compared",)


@pytest.mark.parametrize("first", [0, 9, 71, 204])
def test_a_tube_may_begin_at_any_tick(first: int):
    # one tick in eight is a little later than its decimals say
    window = Sampled("plant.p_B[2]", "m", t[first:], SINE[first:], 0.05, 0.004)
    now = replace(coming_to(1.0), curves={"z": window})
    stored = baseline_of(EXPERIMENT, "x", now, [Entry(date="2026-01-01", reason="first")], None)
    assert words(verdict(EXPERIMENT, "x", stored, now)) == ["ok", "ok"]
