"""Fig. 4 on the shipped experiments, and sabotaged runs that have to fail."""

from pathlib import Path

import numpy as np
import pytest

from tests.paper.printed import PrintedEstimator
from twin.assembly import belief
from twin.cosim.python_component import PythonComponent
from twin.errors import InputRefused
from twin.execution import execute
from twin.experiment.experiment import load_experiment
from twin.metrics.response import settling_time
from twin.metrics.tracking import rms
from twin.paper.claim import judged
from twin.paper.fig4 import CLAIMS
from twin.paper.fig4_runs import FINAL, SWEEP, Fig4Runs, fig4_runs
from twin.paper.score import Score, fig4_score
from twin.recording.reader import read
from twin.recording.recording import Recording


@pytest.fixture(scope="module")
def runs(force_position: Recording, position: Recording) -> Fig4Runs:
    return fig4_runs(force_position, position)


def sabotaged(root: Path, folder: Path, *overrides: str, printed: bool = False) -> Score:
    """Both experiments with something wrong in them, scored."""
    recordings = []
    for name in ("fig4_force_position", "fig4_position"):
        experiment = load_experiment(root / "experiments" / f"{name}.toml", overrides)
        substitutes = {}
        if printed:
            model = PrintedEstimator(belief(experiment))
            substitutes["estimator"] = PythonComponent("estimator", model, experiment.controller_ticks)
        (folder / name).mkdir()
        recordings.append(read(execute(experiment, folder / name, substitutes=substitutes).recording))
    return fig4_score(fig4_runs(*recordings))


def test_no_claim_fails_on_the_shipped_experiments(runs: Fig4Runs):
    assert fig4_score(runs).failed == []


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("drive.parameters.droop=0", {"position_error", "position_below"}),
        ("controller.gravity_compensation=false", {"trigger_time"}),
        ("controller.mode=position", {"trigger_time", "reference_jumps"}),
    ],
)
def test_a_sabotaged_run_fails_the_claims_it_should(root: Path, tmp_path: Path, override: str, expected: set[str]):
    assert expected <= set(sabotaged(root, tmp_path, override).failed)


def test_equation_23_as_printed_fails(root: Path, tmp_path: Path):
    assert {"reference_returns", "true_force"} <= set(sabotaged(root, tmp_path, printed=True).failed)


def test_forces_in_x_are_trivially_zero_on_a_level_scale_and_judged_on_a_tilted_one(
    root: Path, tmp_path: Path, runs: Fig4Runs, position: Recording
):
    claim = next(claim for claim in CLAIMS if claim.key == "x_small")
    assert judged(claim, runs).verdict == "trivial"
    tilted = execute(load_experiment(root / "experiments/fig4_imperfect.toml"), tmp_path)
    finding = judged(claim, fig4_runs(read(tilted.recording), position))
    assert finding.verdict == "holds"
    # 5 N on a plane tilted by 1 degree push 5 sin(1 deg) = 0.087 N sideways, about 8 % of the friction
    assert finding.value == pytest.approx(0.08, abs=0.02)


# Reference values of an independent computation (docs/physics.md) with its tolerances.
def test_the_force_position_run_agrees_with_the_independent_computation(runs: Fig4Runs):
    run = runs.force_position
    assert run.trigger_time == pytest.approx(5.61, abs=0.05)
    assert 1e3 * run.z_cmd.min() == pytest.approx(-113.0, abs=0.3)
    assert 1e3 * (run.z_cmd - run.z_ref)[run.at(*FINAL)].mean() == pytest.approx(-0.43, abs=0.15)
    until = run.at(0.0, 19.8)
    assert settling_time(run.t[until], run.F_z[until], 5.0, 0.25) == pytest.approx(6.3, abs=0.15)
    assert run.true_F_z.max() < 5.0
    assert run.true_F_z[run.truly_at(*FINAL)].mean() == pytest.approx(4.88, abs=0.1)
    assert rms(run.true_F_z[run.truly_at(*SWEEP)] - 5.0) == pytest.approx(0.09, rel=0.1)
    assert 1e3 * rms(run.true_z_error[run.at(*SWEEP)]) == pytest.approx(0.07, rel=0.1)
    assert np.abs(run.true_F_ee_B[:, 1]).max() == pytest.approx(1.09, rel=0.05)


def test_the_position_run_agrees_with_the_independent_computation(runs: Fig4Runs):
    run = runs.position
    assert run.true_F_z[run.truly_at(*FINAL)].mean() == pytest.approx(4.48, abs=0.15)
    assert rms(run.true_F_z[run.truly_at(*SWEEP)] - 5.0) == pytest.approx(0.56, rel=0.1)
    assert 1e3 * rms(run.true_z_error[run.at(*SWEEP)]) == pytest.approx(0.45, rel=0.1)
    assert np.abs(run.true_F_ee_B[:, 1]).max() == pytest.approx(0.98, rel=0.05)


def test_without_droop_the_position_run_ends_near_5_newton(root: Path, tmp_path: Path):
    """Backlash alone does not leave the gap that the paper blames on it."""
    experiment = load_experiment(root / "experiments/fig4_position.toml", drive="ideal_velocity")
    recording = read(execute(experiment, tmp_path).recording)
    run = fig4_runs(recording, recording).position
    assert run.true_F_z[run.truly_at(*FINAL)].mean() == pytest.approx(4.98, abs=0.02)


def test_tuned_parameters_are_listed_with_their_reason(runs: Fig4Runs):
    assert "contact.stiffness_N_per_m" in runs.tuned
    assert all(reason.startswith("tuned: ") for reason in runs.tuned.values())


def test_runs_in_the_wrong_order_are_refused(force_position: Recording, position: Recording):
    with pytest.raises(InputRefused, match="give the force-position run first"):
        fig4_runs(position, force_position)


def test_a_run_that_is_too_short_is_refused(root: Path, tmp_path: Path):
    experiment = load_experiment(root / "experiments/fig4_position.toml", ["duration_s=2"])
    short = read(execute(experiment, tmp_path).recording)
    with pytest.raises(InputRefused, match=r"ends at 2.000 s; Fig. 4 needs"):
        fig4_runs(short, short)
