"""A baseline survives its file, and an update leaves what people have decided."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.laws.runs import shipped
from tests.studies.check.traces import EXPERIMENT, t
from twin.errors import InputRefused
from twin.studies.check.baseline import (
    Entry,
    baseline_file,
    baseline_of,
    baseline_text,
    fingerprint,
    known_baseline,
    read_baseline,
    write_baseline,
)
from twin.studies.check.measurement import Measured, Sampled
from twin.studies.check.metric import Metric

FIRST = Entry(date="2026-01-01", reason='first, "as it is"')
NOW = Measured(
    {"z.rise_time": Metric(1.0, "s", 2e-3), "z.peak": Metric(-0.09, "m", 2e-6, "none", scale=0.005)},
    {"z": Sampled("plant.p_B[2]", "m", t, np.sin(t), 0.05, 0.004)},
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
    assert str(refused.value).endswith("remove it and write it anew with --update")


def test_a_baseline_is_of_its_pair_and_another_file_of_the_drive_is_the_same_drive(tmp_path: Path):
    file = baseline_file(tmp_path, EXPERIMENT.name, "vendor/x.fmu")
    write_baseline(file, baseline_text(baseline_of(EXPERIMENT, "vendor/x.fmu", NOW, [FIRST], None)))
    assert known_baseline(tmp_path, EXPERIMENT.name, "vendor/next/x.fmu") is not None
    assert known_baseline(tmp_path, EXPERIMENT.name, "y") is None
    file.rename(file.with_stem("y"))
    with pytest.raises(InputRefused, match=r"y.toml: the baseline of step_z_air with vendor/x.fmu, expected .* with y"):
        known_baseline(tmp_path, EXPERIMENT.name, "y")
