"""

A run of a sweep says to Fig. 4 what `twin compare --paper fig4` says to the same two recordings.
"""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.studies.sweep.definitions import STIFFNESS, written
from twin.kernel.errors import InputRefused
from twin.kernel.recording.reader import Recording, read
from twin.kernel.serialise import to_dict
from twin.robot.assembly.load import load_experiment
from twin.robot.run.run import execute
from twin.studies.check.measurement import measure_signals, run_for_measures
from twin.studies.paper.fig4 import fig4_score
from twin.studies.paper.fig4_measures import fig4_runs
from twin.studies.sweep.claims import CURVE_PERIOD, pack_curves, unpack_curves
from twin.studies.sweep.measures import BY_KIND, METRICS, metric_names, metrics_of
from twin.studies.sweep.plan import read_plan
from twin.studies.sweep.worker import record_run, trial

SETTINGS = ("duration_s=6", f"{STIFFNESS}=2000")


@pytest.mark.parametrize("drive", [None, "brushed_dc"])
def test_metrics_equal_those_of_a_recorded_run(root: Path, tmp_path: Path, drive: str | None):
    path = root / "experiments/fig4_force_position.toml"
    run = execute(load_experiment(path, SETTINGS, drive), tmp_path)
    finding = trial(path, drive, SETTINGS)
    assert (finding["status"], finding["reason"]) == ("done", "")
    assert finding["metrics"] == metrics_of(run.outcome)
    assert list(finding["metrics"]) == list(METRICS) and finding["metrics"]["force_error_N"]
    assert 0.0 < finding["stepping_s"] < finding["seconds"]


@pytest.mark.parametrize("name", ["step_z_air", "step_force_scale", "track_circle", "track_chirp"])
def test_measures_are_what_twin_check_measures(root: Path, name: str):
    path = root / f"experiments/{name}.toml"
    experiment = load_experiment(path)
    found = {metric: m.value for metric, m in measure_signals(experiment, run_for_measures(experiment)).metrics.items()}
    mine = trial(path, None, ())["metrics"]
    assert found and found.items() <= mine.items()
    assert mine.keys() == {*METRICS, *found} <= set(metric_names(experiment.measures))


REQUIRED = '{name="low", kind="requirement", formula="always (plant.p_B[2] <= 0 mm)"}'
SWING = '{name="swing", kind="oscillation", signal="plant.p_B[2]", lowest_Hz=300}'


def test_every_metric_that_is_announced_for_a_kind_of_measure_is_made(root: Path):
    made: dict[str, set[str]] = {}
    shipped: list[tuple[str, list[str]]] = [
        (name, []) for name in ("step_force_scale", "step_z_air", "track_chirp", "track_circle")
    ]
    for name, settings in [*shipped, ("step_z_air", ["duration_s=0.02", f"measure=[{REQUIRED}, {SWING}]"])]:
        path = root / f"experiments/{name}.toml"
        kinds = {measure.name: measure.kind for measure in load_experiment(path, settings).measures}
        for metric in trial(path, None, settings)["metrics"]:
            if "." in metric:
                measure, _, number = metric.partition(".")
                made.setdefault(kinds[measure], set()).add(number)
    assert made == {kind: set(numbers) for kind, numbers in BY_KIND.items()}


def test_a_measure_without_meaning_in_a_run_leaves_its_numbers_out_and_the_others_in(root: Path):
    # the platform does not come down to the scale within two seconds, so the force loop is never on
    path = root / "experiments/track_fig4.toml"
    kinds = {m.name: m.kind for m in load_experiment(path).measures}
    begin = [f"measure.{n}.{key}" for n in range(1, len(kinds) + 1) for key in ("begin_s=0.5", "until_s=2")]
    finding = trial(path, None, ["duration_s=2", *begin])
    assert finding["status"] == "done"
    assert "onset" not in {kinds[name.partition(".")[0]] for name in finding["metrics"] if "." in name}
    assert "effort" in {kinds[name.partition(".")[0]] for name in finding["metrics"] if "." in name}


def test_values_that_make_no_experiment_are_a_finding(root: Path):
    finding = trial(root / "experiments/fig4_force_position.toml", None, [f"{STIFFNESS}=-1"])
    assert finding["status"] == "refused" and "stiffness_N_per_m" in finding["reason"]
    assert finding["metrics"] == {}


def test_a_signal_that_is_not_there_is_a_finding_before_a_step_is_made(root: Path):
    finding = trial(root / "experiments/step_z_air.toml", None, ['measure.1.signal="plant.p_A[2]"'])
    assert finding["status"] == "refused" and "did you mean 'plant.p_B'?" in finding["reason"]
    assert finding["stepping_s"] == 0.0


def test_a_trip_of_the_monitor_is_a_status_with_its_reason_and_metrics(root: Path):
    jump = ["contact.shift.by_mm=[0, 0, 8]", "contact.shift.start_s=3", "contact.shift.rise_s=0.05"]
    finding = trial(root / "experiments/pressing.toml", None, jump)
    assert finding["status"] == "tripped" and finding["reason"] and finding["metrics"]["peak_N"]


def test_a_recording_is_that_of_twin_run(root: Path, tmp_path: Path):
    path, settings = root / "experiments/fig4_force_position.toml", ("duration_s=1",)
    execute(load_experiment(path, settings), tmp_path)
    record_run(path, None, settings, tmp_path / "mine")
    assert (tmp_path / "mine" / "run.mcap").read_bytes() == (tmp_path / "run.mcap").read_bytes()
    assert read(tmp_path / "mine" / "run.mcap").complete


def test_a_curve_comes_back_as_it_was_at_every_40_ms():
    t = np.linspace(0.0, 2.0, 2001)
    wave, step = np.sin(5.0 * t), np.where(t < 1.0, -0.105, 5.0)
    kept = json.loads(json.dumps(pack_curves({"wave": (t, wave), "step": (t, step)}, 1.9)))
    times, values = unpack_curves(kept)
    assert times == pytest.approx(np.arange(48) * CURVE_PERIOD)
    for name, curve in (("wave", wave), ("step", step)):
        # 32 bit floats have 24 bits: half of 2^-23 of a number up to 5
        assert values[name] == pytest.approx(np.interp(times, t, curve), abs=3e-7)


def test_curves_say_which_they_are_whatever_their_order():
    t = np.array([0.0, 1.0])
    one, other = (pack_curves({name: (t, t * scale) for name, scale in pairs}, 1.0) for pairs in
                  ([("a", 1.0), ("b", 2.0)], [("b", 2.0), ("a", 1.0)]))  # fmt: skip
    assert unpack_curves(one)[1]["b"][-1] == unpack_curves(other)[1]["b"][-1] == 2.0


def test_the_same_curve_is_kept_in_the_same_bytes():
    t = np.linspace(0.0, 1.0, 11)
    assert pack_curves({"a": (t, t**2)}, 1.0) == pack_curves({"a": (t, t**2)}, 1.0)


@pytest.fixture(scope="module")
def facts(root: Path) -> dict:
    return trial(root / "experiments/fig4_force_position.toml", None, [], "fig4")


def test_claims_measure_and_judge_as_on_recordings(facts: dict, force_position: Recording, position: Recording):
    pair = fig4_runs(force_position, position)
    score = fig4_score(replace(pair, imperfect=(pair.force_position, pair.position)))
    expected = to_dict((*score.claims, *score.quality))
    judged = {one["claim"]: one for one in expected if one["claim"] != "backlash_offset"}
    assert list(facts["claims"]) == list(judged)
    for key, found in facts["claims"].items():
        # the same doubles through the same functions
        assert found == {"value": judged[key]["measured"], "verdict": judged[key]["verdict"]}
    # the shipped robot is symmetrical
    assert facts["claims"]["x_small"]["verdict"] == "trivial"


def test_a_drawn_plant_that_is_not_symmetrical_is_judged_in_x(root: Path):
    settings = ["plant.joint_zero_deg.2=0.05", "contact.tilt_deg=1"]
    found = trial(root / "experiments/fig4_force_position.toml", None, settings, "fig4")["claims"]
    assert {found[key]["verdict"] for key in ("x_small", "friction_smaller_x")} <= {"holds", "fails"}


def test_curves_are_those_of_the_recordings(facts: dict, force_position: Recording, position: Recording):
    t, curves = unpack_curves(facts["curves"])
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
    found = trial(root / "experiments/fig4_force_position.toml", None, ["duration_s=0.02"])
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
        read_plan(written(tmp_path, text))


def test_the_plant_alone_is_uncertain_in_the_shipped_sweep(root: Path):
    plan = read_plan(root / "experiments/sweeps/uncertainty.toml")
    assert plan.definition.claims == "fig4"
    nominal = load_experiment(plan.experiment)
    drawn = load_experiment(plan.experiment, plan.tasks[0].settings)
    assert drawn.controller == nominal.controller
    assert drawn.values["plant"] != nominal.values["plant"]
    assert drawn.drives != nominal.drives and drawn.values["contact"] != nominal.values["contact"]
    touched = {setting.split(".")[0] for task in plan.tasks for setting in task.settings}
    assert touched == {"plant", "drive", "contact"}
