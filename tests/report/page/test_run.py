"""Measures against curves whose measures are known."""

import math
from pathlib import Path

import numpy as np
import pytest

from twin.kernel.recording.reader import Recording, read
from twin.report.page.run import ReportRun, measures, number, outcome
from twin.robot.assembly.load import load_experiment
from twin.robot.run.run import execute
from twin.studies.paper.fig4_measures import FINAL, Fig4Run


def test_measures_of_fig4_are_those_of_its_claims(force_position: Recording):
    found = {measure.text: measure for measure in measures(ReportRun("", force_position))}
    run = Fig4Run(force_position)
    settled = found["within 5 % of 5 N to the end from"]
    # the reference computation's own tolerance
    assert settled.true == pytest.approx(6.46, abs=0.15) and settled.believed == pytest.approx(6.3, abs=0.15)
    end = found["force at the end, mean of the last second"]
    # 0.1 s more at rest than the figure's window
    assert end.true == pytest.approx(run.true_F_z[run.truly_at(*FINAL)].mean(), abs=1e-3)
    assert found["largest pressing force"].true == run.true_F_z.max()
    assert outcome(ReportRun("", force_position)).startswith("The true force stays within 5 % of 5 N from 6.4")


@pytest.mark.parametrize("name", ["fig4_force_position", "pressing"])
def test_the_force_error_is_the_one_that_the_run_tells(root: Path, tmp_path: Path, name: str):
    run = execute(load_experiment(root / f"experiments/{name}.toml"), tmp_path)
    (found,) = (m for m in measures(ReportRun("", read(run.recording))) if m.short == "force error")
    assert run.outcome.force_error is not None
    # sums in another order
    assert found.true == pytest.approx(run.outcome.force_error, rel=1e-9)


def test_there_is_no_belief_where_only_the_truth_is_measured(force_position: Recording):
    found = {measure.text: measure for measure in measures(ReportRun("", force_position))}
    assert np.isnan(found["largest motor torque"].believed)


def test_numbers_are_told_with_four_digits():
    assert number(4.88421, "N") == "4.884 N"
    assert number(math.inf, "s") == "never"
    assert number(math.nan, "s") == ""
