"""Whole runs: determinism, failures in mid-run, provenance."""

import hashlib
import json
import re
from pathlib import Path

import numpy as np
import pytest

from tests.kernel.fmi.faulty import faulty_drive
from tests.robot.plant.kinetic import mass_matrix
from twin.kernel.errors import ComponentFailed
from twin.kernel.recording.reader import Recording, read
from twin.robot.assembly.build import plant_parameters
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.mechanism.kinematics import jacobian, joint_angles
from twin.robot.run.run import MAX_POLE_STEP, SUMMARY_FILE, execute, fast_pole_remedy, fastest_pole


def stiff(root: Path, *settings: str) -> Experiment:
    return load_experiment(root / "experiments/fig4_force_position.toml", ["duration_s=0.2", *settings])


def test_the_pole_of_friction_alone_is_damping_over_inertia(root: Path):
    """Far above all springs the poles are the eigenvalues of M^-1 b_j J^T J, with M of uniform rods: (P6)."""
    experiment = stiff(root, "plant.b_j_Nm_s_per_rad=200", "plant.eta_rate_rad_per_s=0")
    geometry = geometry_of(experiment.plant)
    J = jacobian(geometry, experiment.start)
    M = mass_matrix(plant_parameters(experiment.plant, experiment.contact), joint_angles(geometry, experiment.start), J)
    expected = np.linalg.eigvals(np.linalg.solve(M, 200.0 * J.T @ J)).real.max()
    # the springs are 1e-4 of it
    assert fastest_pole(experiment) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("settings", [[], ["contact.body=back", "contact.height_mm=-100"]])
def test_the_shipped_plants_are_slow_enough(root: Path, settings: list[str]):
    assert fast_pole_remedy(stiff(root, *settings)) == ""


def test_friction_that_is_too_stiff_for_the_tick_names_the_substeps_that_help(root: Path, tmp_path: Path):
    friction = "plant.b_j_Nm_s_per_rad=20"
    (tmp_path / "a").mkdir()
    (tmp_path / "b").mkdir()
    with pytest.raises(ComponentFailed, match=r"fastest pole is about 6.3e\+04 1/s") as failed:
        execute(stiff(root, friction), tmp_path / "a")
    substeps = re.search(r"set \[plant\] substeps = (\d+)", str(failed.value))
    assert substeps
    execute(stiff(root, friction, f"plant.substeps={substeps[1]}"), tmp_path / "b")


def test_a_plant_whose_numbers_are_absurd_blames_neither_drive_nor_tick(root: Path, tmp_path: Path):
    with pytest.raises(ComponentFailed) as failed:
        execute(stiff(root, "plant.m_p_g=1e308"), tmp_path)
    assert "absurd stiffness, mass or damping" in str(failed.value)
    assert "drive check" not in str(failed.value)


def test_the_limit_is_that_of_classical_runge_kutta():
    """|1 + z + z^2/2 + z^3/6 + z^4/24| <= 1 up to 2.785 on the negative real axis, 2.828 on the imaginary one."""

    def growth(z: complex) -> float:
        return abs(1 + z + z**2 / 2 + z**3 / 6 + z**4 / 24)

    assert growth(-MAX_POLE_STEP) <= 1.0 and growth(1j * MAX_POLE_STEP) <= 1.0
    assert growth(-MAX_POLE_STEP * 1.04) > 1.0 and growth(1j * MAX_POLE_STEP * 1.05) > 1.0
    assert np.isclose(growth(-2.785293563), 1.0, atol=1e-6)


SHORT = ["duration_s=2"]


def test_the_same_experiment_gives_the_same_bytes(root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    recordings = []
    for name in ("a", "b"):
        folder = tmp_path / name
        folder.mkdir()
        monkeypatch.chdir(folder)
        experiment = load_experiment(root / "experiments/fig4_force_position.toml", SHORT)
        recordings.append(execute(experiment, folder).recording.read_bytes())
    assert recordings[0] == recordings[1]
    for trace in (str(root), str(tmp_path), "tmp"):
        assert trace.encode() not in recordings[0]


def test_every_signal_is_recorded_at_its_rate(force_position: Recording):
    assert len(force_position.time("plant")) == 20_001
    assert len(force_position.time("drive/2")) == 20_001
    assert len(force_position.time("controller")) == 10_001
    assert len(force_position.time("scale")) == 2_001
    # a product k*dt in nanoseconds, so every time is the nearest float
    assert np.array_equal(force_position.time("plant"), np.arange(20_001) * 1_000_000 / 1e9)


def test_at_the_controllers_rate_every_topic_holds_what_was_valid_when_the_controller_acted(
    root: Path, tmp_path: Path, force_position: Recording
):
    overrides = [*SHORT, "recording.rate='controller'"]
    experiment = load_experiment(root / "experiments/fig4_force_position.toml", overrides)
    recording = read(execute(experiment, tmp_path).recording)
    for topic in ("plant", "drive/1", "drive/2", "drive/3", "controller"):
        assert np.array_equal(recording.time(topic), np.arange(1001) * 2_000_000 / 1e9)
    assert np.array_equal(recording["plant.p_B"], force_position["plant.p_B"][:2001:2])
    assert np.array_equal(recording["drive/3.omega_m"], force_position["drive/3.omega_m"][:2001:2])
    # slower ones keep their own rate
    assert np.array_equal(recording["scale.F_z"], force_position["scale.F_z"][:201])


def test_a_row_holds_only_what_was_valid_at_its_tick(force_position: Recording):
    counts = np.floor(force_position["plant.theta_l"][::2] * (16384 / (2 * np.pi)) + 0.5)
    assert np.array_equal(force_position["encoder.count_l"], counts)


def test_the_recording_says_where_everything_comes_from(root: Path, force_position: Recording):
    fmu = root / "fmus/velocity_servo/velocity_servo.fmu"
    drive = json.loads(force_position.metadata["fmu"]["drive_1"])
    assert drive["sha256"] == hashlib.sha256(fmu.read_bytes()).hexdigest()
    assert drive["set"] == {"droop": 0.6}
    assert "tau_load <- tau_load [N.m]" in drive["mapped"]
    values = json.loads(force_position.metadata["experiment"]["values"])
    assert values["contact"]["height_mm"] == -101.0
    assert force_position.metadata["origins"]["robot.N"] == "Sec. II.B.1: N = 2"
    assert "numba" in force_position.metadata["versions"]


def test_every_field_has_a_meaning(force_position: Recording):
    assert [name for name, field in force_position.fields().items() if not field.meaning or not field.unit] == []


def test_the_trigger_is_an_event(force_position: Recording):
    (event,) = [event for event in force_position.events if "triggered" in event.text]
    rise = force_position.time("controller")[np.argmax(force_position["controller.triggered"])]
    assert event.time == rise


@pytest.mark.parametrize(
    ("fault", "said"),
    [
        (1, "faulty.fmu (drive_2) fmi2DoStep returned fmi2Error"),
        (2, "faulty.fmu (drive_2) returned NaN for omega_m"),
        (3, "faulty.fmu (drive_2) returned infinity for theta_m"),
    ],
)
def test_a_drive_that_fails_in_mid_run_stops_it_at_that_tick(root: Path, tmp_path: Path, fault: int, said: str):
    fmu = faulty_drive(root, tmp_path)
    overrides = [*SHORT, f"drive.joint_2.fmu='{fmu}'", f"drive.joint_2.parameters.droop={fault}"]
    experiment = load_experiment(root / "experiments/fig4_position.toml", overrides)
    folder = tmp_path / "run"
    folder.mkdir()
    with pytest.raises(ComponentFailed) as failure:
        execute(experiment, folder)
    text = str(failure.value)
    assert text.startswith(said)
    assert "in the step from t = 0.999 s, tick 999. Last inputs: omega_ref = " in text
    assert text.endswith(f"Try: twin drive check {fmu}")
    assert failure.value.exit_code == 3
    assert sorted(path.name for path in folder.iterdir()) == ["run.mcap.partial"]
    partial = read(folder / "run.mcap.partial")
    assert not partial.complete
    assert partial.time("plant")[-1] == 0.999
    assert partial.events[-1].text.startswith(said)


@pytest.mark.parametrize("key", ["delay_ticks", "bus_delay_ticks"])
def test_a_delay_of_computation_or_bus_delays_the_motors_by_as_much(root: Path, tmp_path: Path, key: str):
    speeds = []
    for ticks in (0, 3):
        folder = tmp_path / str(ticks)
        folder.mkdir()
        overrides = ["duration_s=1", f"controller.{key}={ticks}"]
        experiment = load_experiment(root / "experiments/fig4_position.toml", overrides, drive="ideal_velocity")
        recording = read(execute(experiment, folder).recording)
        speeds.append(np.stack([recording[f"drive/{i}.omega_m"] for i in (1, 2, 3)]))
    moved = [int(np.argmax(np.any(speed != 0.0, axis=0))) for speed in speeds]
    assert moved[1] - moved[0] == 3


def test_the_summary_tells_cost_and_drives(root: Path, tmp_path: Path):
    experiment = load_experiment(root / "experiments/fig4_position.toml", SHORT)
    run = execute(experiment, str(tmp_path), timed=True)
    summary = json.loads((tmp_path / SUMMARY_FILE).read_text())
    assert summary["real_time_factor"] == run.real_time_factor > 1
    assert summary["microseconds"].keys() >= {"plant", "drive_1", "estimator"}
    # the parts cannot take longer than the whole
    assert sum(run.microseconds.values()) <= 1e6 * run.stepping / 2000
