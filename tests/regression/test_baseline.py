"""A baseline survives its file, and an update leaves what people have decided."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.laws.runs import shipped
from tests.regression.traces import EXPERIMENT, t
from twin.errors import InputRefused
from twin.regression.baseline import Entry, baseline_of, baseline_text, fingerprint, read_baseline
from twin.regression.measurement import Measured, Sampled
from twin.regression.metric import Metric

FIRST = Entry("2026-01-01", 'first, "as it is"')
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
    edited = text.replace("bound = 0.02 }", "bound = 0.3, keep = true }").replace("bound = 0.0001 }", "bound = 0.7 }")
    before = read_baseline(stored(tmp_path, edited))
    after = baseline_of(EXPERIMENT, "x", NOW, [FIRST], before).metrics
    assert (after["z.rise_time"].bound, after["z.rise_time"].keep) == (0.3, True)
    assert after["z.peak"].bound == 1e-4


def test_a_curve_is_thinned_to_a_few_samples_of_itself():
    tube = baseline_of(EXPERIMENT, "x", NOW, [FIRST], None).tubes["z"]
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
        ("  0.0, 0.256", "  0.5, 0.256", "times that increase"),
    ],
)
def test_a_damaged_baseline_is_refused_in_one_sentence(tmp_path: Path, old: str, new: str, said: str):
    text = baseline_text(baseline_of(EXPERIMENT, "x", NOW, [FIRST], None))
    assert old in text
    with pytest.raises(InputRefused, match=said):
        read_baseline(stored(tmp_path, text.replace(old, new)))
