"""A run of a sweep says to Fig. 4 what `twin compare --paper fig4` says to the same two recordings."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.studies.sweep.definitions import written
from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import Recording
from twin.robot.assembly.load import load_experiment
from twin.studies.paper.claim import as_facts
from twin.studies.paper.fig4 import fig4_score
from twin.studies.paper.fig4_measures import fig4_runs
from twin.studies.sweep.plan import planned
from twin.studies.sweep.worker import PERIOD, packed, trial, unpacked


def test_a_curve_comes_back_as_it_was_at_every_40_ms():
    t = np.linspace(0.0, 2.0, 2001)
    wave, step = np.sin(5.0 * t), np.where(t < 1.0, -0.105, 5.0)
    kept = json.loads(json.dumps(packed({"wave": (t, wave), "step": (t, step)}, 1.9)))
    times, values = unpacked(kept)
    assert times == pytest.approx(np.arange(48) * PERIOD)
    for name, curve in (("wave", wave), ("step", step)):
        # 32 bit floats have 24 bits: half of 2^-23 of a number up to 5
        assert values[name] == pytest.approx(np.interp(times, t, curve), abs=3e-7)


def test_curves_say_which_they_are_whatever_their_order():
    t = np.array([0.0, 1.0])
    one, other = (packed({name: (t, t * scale) for name, scale in pairs}, 1.0) for pairs in
                  ([("a", 1.0), ("b", 2.0)], [("b", 2.0), ("a", 1.0)]))  # fmt: skip
    assert unpacked(one)[1]["b"][-1] == unpacked(other)[1]["b"][-1] == 2.0


def test_the_same_curve_is_kept_in_the_same_bytes():
    t = np.linspace(0.0, 1.0, 11)
    assert packed({"a": (t, t**2)}, 1.0) == packed({"a": (t, t**2)}, 1.0)


@pytest.fixture(scope="module")
def facts(root: Path) -> dict:
    return trial(root / "experiments/fig4_force_position.toml", None, [], "fig4").facts


def test_claims_measure_and_judge_as_on_recordings(facts: dict, force_position: Recording, position: Recording):
    pair = fig4_runs(force_position, position)
    score = fig4_score(replace(pair, imperfect=(pair.force_position, pair.position)))
    expected = [as_facts(finding) for finding in (*score.claims, *score.quality)]
    judged = {one["claim"]: one for one in expected if one["claim"] != "backlash_offset"}
    assert list(facts["claims"]) == list(judged)
    for key, found in facts["claims"].items():
        # the same doubles through the same functions
        assert found == {"value": judged[key]["measured"], "verdict": judged[key]["verdict"]}
    # the shipped robot is symmetrical
    assert facts["claims"]["x_small"]["verdict"] == "trivial"


def test_a_drawn_plant_that_is_not_symmetrical_is_judged_in_x(root: Path):
    settings = ["plant.joint_zero_deg.2=0.05", "contact.tilt_deg=1"]
    found = trial(root / "experiments/fig4_force_position.toml", None, settings, "fig4").facts["claims"]
    assert {found[key]["verdict"] for key in ("x_small", "friction_smaller_x")} <= {"holds", "fails"}


def test_curves_are_those_of_the_recordings(facts: dict, force_position: Recording, position: Recording):
    t, curves = unpacked(facts["curves"])
    for name, run in (("force_position", force_position), ("position", position)):
        truth = np.interp(t, run.time("plant"), -run["plant.F_ee_B"][:, 2])
        # 32 bit floats: half of 2^-23 of 5 N
        assert curves[f"{name}.true_F_z"] == pytest.approx(truth, abs=3e-7)
        assert curves[f"{name}.z"] == pytest.approx(
            np.interp(t, run.time("estimator"), run["estimator.p_B"][:, 2]), abs=1e-8
        )
        assert curves[f"{name}.F_y"].min() < -0.9
    assert len(curves) == 13


def test_a_sweep_without_claims_keeps_neither_claims_nor_curves(root: Path):
    found = trial(root / "experiments/fig4_force_position.toml", None, ["duration_s=0.02"]).facts
    assert not found.keys() & {"claims", "curves"}


@pytest.mark.parametrize(
    ("experiment", "sentence"),
    [("step_z_air.toml", "needs 19.9 s"), ("fig4_position.toml", 'needs controller.mode = "force_position"')],
)
def test_an_experiment_that_fig4_cannot_be_asked_of_is_refused_before_the_first_run(
    root: Path, tmp_path: Path, experiment: str, sentence: str
):
    text = f'experiment = "{root}/experiments/{experiment}"\nclaims = "fig4"\n'
    text += 'vary = [{ key = "plant.eta", values = [0.9, 1.0] }]'
    with pytest.raises(InputRefused, match=sentence):
        planned(written(tmp_path, text))


def test_the_plant_alone_is_uncertain_in_the_shipped_sweep(root: Path):
    plan = planned(root / "experiments/sweeps/uncertainty.toml")
    assert plan.definition.claims == "fig4"
    nominal = load_experiment(plan.experiment)
    drawn = load_experiment(plan.experiment, plan.tasks[0].settings)
    assert drawn.controller == nominal.controller
    assert drawn.values["plant"] != nominal.values["plant"]
    assert drawn.drives != nominal.drives and drawn.values["contact"] != nominal.values["contact"]
    touched = {setting.split(".")[0] for task in plan.tasks for setting in task.settings}
    assert touched == {"plant", "drive", "contact"}
