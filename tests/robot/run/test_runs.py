"""Runs in memory, one after the other: outcomes, and the bits of a run from the start where a past is shared."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.laws.runs import shipped
from twin.kernel.cosim.system import System
from twin.kernel.errors import ComponentFailed, InputRefused
from twin.robot.experiment.experiment import Experiment
from twin.robot.run import runs as of_runs
from twin.robot.run.runs import RunRequest, Runs

EVERYTHING = RunRequest(signals=frozenset({"plant.F_ee_B"}), tally=True, idle=True)
LOSS = 'fault=[{{kind="sample_loss",onset_s={onset},duration_s=0.02,magnitude_share=1.0}}]'


def pressing(seconds: float, *settings: str) -> Experiment:
    """The first `seconds` of pressing."""
    return replace(shipped("pressing", *settings), duration_ticks=round(1e3 * seconds))


def softer(at: float) -> Experiment:
    """Pressing with a spring that is softer from `at` (s) on."""
    return pressing(6.5, f'fault=[{{kind="spring_softened",target="joint_1",onset_s={at},magnitude_factor=0.7}}]')


def test_runs_that_share_a_past_have_the_bits_of_runs_from_the_start():
    experiments = [softer(at) for at in (5.0, 5.5, 6.0)]
    with Runs(EVERYTHING, after=1) as shared, Runs(EVERYTHING, most=0) as alone:
        for number, experiment in enumerate(experiments):
            one, other = shared.run(experiment), alone.run(experiment)
            assert one.trace is not None and other.trace is not None
            np.testing.assert_array_equal(one.trace["plant.F_ee_B"], other.trace["plant.F_ee_B"])
            assert (one.status, one.numbers, one.idle) == (other.status, other.numbers, other.idle)
            # the past is run for the second one, and the third goes on from it
            assert [past.shared is not None for past in shared._pasts] == [number > 0]
    assert not shared._pasts


def test_no_more_pasts_are_kept_than_asked_for():
    with Runs(RunRequest(tally=True), most=1) as runs:
        for k_s in (0.8, 0.9, 0.8):
            runs.run(pressing(0.1, f"robot.k_s_Nm_per_rad={k_s}"))
            assert [past.key.plant.k_s for past in runs._pasts] == [k_s]


def test_a_run_that_trips_is_completed_and_has_numbers():
    done = Runs(EVERYTHING, most=0).run(shipped("pressing", LOSS.format(onset=6.5))).completed()
    assert done.status == "tripped" and done.reason and done.trip and not done.idle
    assert done.numbers is not None and done.numbers.measures["hold_error"].value is not None
    assert done.power_off_tick is None or done.power_off_tick > 6500


FAILING = """
class Failing:
    inputs = ("F_ee_B",)
    outputs = ("omega_ref",)

    def step(self, t, inputs):
        if t > 0.1:
            raise ValueError("too late")
        return {"omega_ref": 0.0 * inputs["F_ee_B"]}
"""


def test_a_run_that_fails_keeps_its_trace_and_has_no_numbers(tmp_path: Path):
    (tmp_path / "failing.py").write_text(FAILING)
    done = Runs(EVERYTHING, most=0).run(pressing(0.2, f"controller.python={tmp_path}/failing.py:Failing"))
    assert (done.status, done.culprit, done.numbers) == ("failed", "controller", None)
    assert "too late" in done.reason and done.trace is not None and 100 < len(done.trace.t) < 110
    with pytest.raises(ComponentFailed, match="too late"):
        done.completed()


@pytest.mark.parametrize("most", [0, 2])
def test_a_check_refuses_a_run_before_its_first_tick(most: int, monkeypatch: pytest.MonkeyPatch):
    def refuse(experiment: Experiment, system: System) -> None:
        raise InputRefused(f"{experiment.name} with {len(system.components)} components")

    monkeypatch.setattr(of_runs, "simulate", lambda *args: pytest.fail("it runs"))
    with Runs(RunRequest(check=refuse), most=most) as runs, pytest.raises(InputRefused, match="pressing with"):
        runs.run(pressing(0.1))
