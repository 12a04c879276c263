"""A baseline survives its file, and an update leaves what people have decided."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.laws.runs import shipped
from tests.studies.check.traces import EXPERIMENT, t
from twin.kernel.errors import InputRefused
from twin.studies.check.baseline import (
    Baseline,
    HistoryEntry,
    baseline_file,
    baseline_of,
    baseline_text,
    fingerprint,
    known_baseline,
    read_baseline,
    write_baseline,
)
from twin.studies.check.measurement import Measurement, Metric, SampledCurve, Sense
from twin.studies.check.verdict import CheckVerdict, verdict

FIRST = HistoryEntry(date="2026-01-01", reason='first, "as it is"')
NOW = Measurement(
    {"z.rise_time": Metric(1.0, "s", 2e-3), "z.peak": Metric(-0.09, "m", 2e-6, "none", scale=0.005)},
    {"z": SampledCurve("plant.p_B[2]", "m", t, np.sin(t), 0.05, 0.004)},
    {"x.fmu": "0" * 64},
)


def stored(folder: Path, text: str) -> Path:
    file = folder / "x.toml"
    file.write_text(text)
    return file


def test_what_is_written_is_read(tmp_path: Path):
    written = baseline_of(EXPERIMENT, "x", NOW, [FIRST], None)
    read = read_baseline(stored(tmp_path, baseline_text(written)))
    assert baseline_text(read) == baseline_text(written)
    assert (read.metrics, read.history, read.fmus) == (written.metrics, (FIRST,), NOW.fmus)
    assert np.array_equal(read.tubes["z"].values, written.tubes["z"].values)


def test_a_bound_is_2_percent_of_the_value_or_of_the_step_that_a_coordinate_belongs_to():
    metrics = baseline_of(EXPERIMENT, "x", NOW, [FIRST], None).metrics
    assert metrics["z.rise_time"].bound == 0.02
    assert metrics["z.peak"].bound == 1e-4


def test_an_update_leaves_a_bound_that_is_to_be_kept_and_no_other(tmp_path: Path):
    text = baseline_text(baseline_of(EXPERIMENT, "x", NOW, [FIRST], None))
    edited = text.replace("bound = 0.02}", "bound = 0.3, keep = true}").replace("bound = 0.0001}", "bound = 0.7}")
    before = read_baseline(stored(tmp_path, edited))
    after = baseline_of(EXPERIMENT, "x", NOW, [FIRST], before).metrics
    assert (after["z.rise_time"].bound, after["z.rise_time"].keep) == (0.3, True)
    assert after["z.peak"].bound == 1e-4


def test_a_curve_is_thinned_to_a_few_samples_of_itself():
    tube = baseline_of(EXPERIMENT, "x", NOW, [FIRST], None).tubes["z"].curve
    assert len(tube.t) == 40
    # six digits are kept
    assert np.allclose(tube.values, np.sin(tube.t), atol=1e-5)


def test_the_fingerprint_tells_experiments_from_one_another_but_not_titles_or_places():
    assert fingerprint(shipped("step_z_air", "title=other")) == fingerprint(EXPERIMENT)
    for other in ("controller.position.kp_per_s=1.6", "drive.parameters.droop=0.5", "measure.1.begin_s=0.6"):
        assert fingerprint(shipped("step_z_air", other)) != fingerprint(EXPERIMENT)
    elsewhere = EXPERIMENT.drives[0].model_copy(update={"fmu": "/elsewhere/x.fmu"})
    assert fingerprint(replace(EXPERIMENT, drives=(elsewhere, elsewhere, elsewhere))) == fingerprint(EXPERIMENT)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('drive = "x"\n', "", "no baseline: missing key 'drive'"),
        ("[metrics]", "[metrics", "not valid TOML"),
        ('unit = "s", ', "", "no baseline: .*'unit'"),
        ("  0.0, 0.256", "  0.5, 0.256", r"\[tubes.z\] .*times that increase"),
        ("  0.0, 0.256", "  nan, 0.256", r"\[tubes.z\] t_s = nan \(entry 1\): expected a finite number"),
        ("  0.0, 0.253", "  nan, 0.253", r"\[tubes.z\] values = nan \(entry 1\): expected a finite number"),
        ("tolerance = 0.05", "tolerance = -0.05", r"\[tubes.z\] tolerance = -0.05: expected a number >= 0"),
        ("value = 1.0,", "value = nan,", r"\[metrics.z.rise_time\] value = nan: expected a finite number"),
        ("value = 1.0,", 'value = "fast",', r'\[metrics.z.rise_time\] value = "fast": expected a number'),
        ("bound = 0.02}", "bound = -0.02}", r"\[metrics.z.rise_time\] bound = -0.02: expected a number >= 0"),
        ("bound = 0.02}", "bound = 0.02, kep = true}", "unknown key 'kep'; did you mean 'keep'"),
        ('drive = "x"', "drive = 3", "drive = 3: expected text in quotes"),
        ("[metrics]", "[[metrics]]", "no baseline: "),
    ],
)
def test_a_damaged_baseline_is_refused_in_one_sentence(tmp_path: Path, old: str, new: str, said: str):
    text = baseline_text(baseline_of(EXPERIMENT, "x", NOW, [FIRST], None))
    assert old in text
    with pytest.raises(InputRefused, match=said) as refused:
        read_baseline(stored(tmp_path, text.replace(old, new)))
    assert str(refused.value).endswith("remove it and rewrite it with --update")


def test_a_baseline_is_of_its_pair_and_another_file_of_the_drive_is_the_same_drive(tmp_path: Path):
    file = baseline_file(tmp_path, EXPERIMENT.name, "vendor/x.fmu")
    write_baseline(file, baseline_text(baseline_of(EXPERIMENT, "vendor/x.fmu", NOW, [FIRST], None)))
    assert known_baseline(tmp_path, EXPERIMENT.name, "vendor/next/x.fmu") is not None
    assert known_baseline(tmp_path, EXPERIMENT.name, "y") is None
    file.rename(file.with_stem("y"))
    with pytest.raises(InputRefused, match=r"y.toml: the baseline of step_z_air with vendor/x.fmu, expected .* with y"):
        known_baseline(tmp_path, EXPERIMENT.name, "y")


SINE = np.sin(t)


def coming_to(value: float, sense: Sense = "less", curve: np.ndarray = SINE, unit: str = "s") -> Measurement:
    sampled = SampledCurve("plant.p_B[2]", "m", t, curve, 0.05, 0.004)
    return Measurement({"z.number": Metric(value, unit, 0.0, sense)}, {"z": sampled}, {"x.fmu": "0" * 64})


def baseline(value: float = 1.0, sense: Sense = "less") -> Baseline:
    return baseline_of(
        EXPERIMENT, "x", coming_to(value, sense), [HistoryEntry(date="2026-01-01", reason="first")], None
    )


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
    window = SampledCurve("plant.p_B[2]", "m", t[first:], SINE[first:], 0.05, 0.004)
    now = replace(coming_to(1.0), curves={"z": window})
    stored = baseline_of(EXPERIMENT, "x", now, [HistoryEntry(date="2026-01-01", reason="first")], None)
    assert words(verdict(EXPERIMENT, "x", stored, now)) == ["ok", "ok"]
