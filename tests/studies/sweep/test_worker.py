from pathlib import Path

import pytest

from tests.studies.sweep.definitions import STIFFNESS
from twin.kernel.recording.reader import read
from twin.robot.assembly.load import load_experiment
from twin.robot.run.run import execute
from twin.studies.check.measurement import measured, run_for_measures
from twin.studies.sweep.measures import BY_KIND, METRICS, metric_names, metrics_of
from twin.studies.sweep.worker import record, trial

SETTINGS = ("duration_s=6", f"{STIFFNESS}=2000")


@pytest.mark.parametrize("drive", [None, "brushed_dc"])
def test_metrics_equal_those_of_a_recorded_run(root: Path, tmp_path: Path, drive: str | None):
    path = root / "experiments/fig4_force_position.toml"
    run = execute(load_experiment(path, SETTINGS, drive), tmp_path)
    finding = trial(path, drive, SETTINGS)
    assert (finding.status, finding.reason) == ("done", "")
    assert finding.metrics == metrics_of(run.outcome)
    assert list(finding.metrics) == list(METRICS) and finding.metrics["force_error_N"]
    assert 0.0 < finding.stepping < finding.seconds


@pytest.mark.parametrize("name", ["step_z_air", "step_force_scale", "track_circle", "track_chirp"])
def test_measures_are_what_twin_check_measures(root: Path, name: str):
    path = root / f"experiments/{name}.toml"
    experiment = load_experiment(path)
    found = {metric: m.value for metric, m in measured(experiment, run_for_measures(experiment)).metrics.items()}
    mine = trial(path, None, ()).metrics
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
        for metric in trial(path, None, settings).metrics:
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
    assert finding.status == "done"
    assert "onset" not in {kinds[name.partition(".")[0]] for name in finding.metrics if "." in name}
    assert "effort" in {kinds[name.partition(".")[0]] for name in finding.metrics if "." in name}


def test_values_that_make_no_experiment_are_a_finding(root: Path):
    finding = trial(root / "experiments/fig4_force_position.toml", None, [f"{STIFFNESS}=-1"])
    assert finding.status == "refused" and "stiffness_N_per_m" in finding.reason
    assert finding.facts["metrics"] == {}


def test_a_signal_that_is_not_there_is_a_finding_before_a_step_is_made(root: Path):
    finding = trial(root / "experiments/step_z_air.toml", None, ['measure.1.signal="plant.p_A[2]"'])
    assert finding.status == "refused" and "did you mean 'plant.p_B'?" in finding.reason
    assert finding.stepping == 0.0


def test_a_trip_of_the_monitor_is_a_status_with_its_reason_and_metrics(root: Path):
    jump = ["contact.shift.by_mm=[0, 0, 8]", "contact.shift.start_s=3", "contact.shift.rise_s=0.05"]
    finding = trial(root / "experiments/pressing.toml", None, jump)
    assert finding.status == "tripped" and finding.reason and finding.metrics["peak_N"]


def test_a_recording_is_that_of_twin_run(root: Path, tmp_path: Path):
    path, settings = root / "experiments/fig4_force_position.toml", ("duration_s=1",)
    execute(load_experiment(path, settings), tmp_path)
    record(path, None, settings, tmp_path / "mine")
    assert (tmp_path / "mine" / "run.mcap").read_bytes() == (tmp_path / "run.mcap").read_bytes()
    assert read(tmp_path / "mine" / "run.mcap").complete
