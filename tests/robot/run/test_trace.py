"""A run in memory is its recording, signal by signal, whichever of its rows and signals are kept."""

from pathlib import Path

import numpy as np
import pytest

from tests.kernel.fmi.faulty import faulty_drive
from tests.laws.runs import EXPERIMENTS, FORCE, shipped
from twin.kernel.cosim.observers import simulate
from twin.kernel.errors import ComponentFailed, UnknownSeries
from twin.kernel.recording.reader import Recording, read
from twin.robot.assembly.assemble import assemble
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import shorten
from twin.robot.run.run import execute
from twin.robot.run.trace import Trace, run_in_memory

SHORT = "duration_s=0.5"
BROKEN = """fault=[{kind='encoder_bias', onset_s=0.1, magnitude_deg=0.5},
    {kind='belief_eta', onset_s=0.2, magnitude_factor=0.9}]"""
AT_THE_CONTROLLERS_RATE = "recording.rate='controller'"


def assert_same(run: Trace, recording: Recording) -> None:
    assert run.fields() == recording.fields()
    for key in recording.fields():
        assert run[key].dtype == recording[key].dtype
        np.testing.assert_array_equal(run[key], recording[key], strict=True)
    for topic in recording.streams:
        np.testing.assert_array_equal(run.time(topic), recording.time(topic), strict=True)


@pytest.mark.parametrize(
    ("name", "overrides", "drive"),
    [(FORCE, (), None), ("pressing", (BROKEN,), "torque_motor_fmi3"), ("track_breathing", (), None)],
    ids=["way points", "task, monitor, faults and another drive", "moving body"],
)
def test_a_run_in_memory_is_its_recording_read_back(
    tmp_path: Path, name: str, overrides: tuple[str, ...], drive: str | None
):
    experiment = shorten(load_experiment(EXPERIMENTS / f"{name}.toml", overrides, drive), 0.5)
    assert_same(run_in_memory(experiment), read(execute(experiment, tmp_path).recording))


def test_kept_when_the_controller_acts_it_is_the_recording_at_the_controllers_rate(tmp_path: Path):
    experiment = shipped(FORCE, SHORT, AT_THE_CONTROLLERS_RATE)
    run = run_in_memory(experiment, experiment.controller_ticks)
    assert_same(run, read(execute(experiment, tmp_path).recording))


@pytest.fixture(scope="module")
def whole() -> Trace:
    return run_in_memory(shipped(FORCE, SHORT))


@pytest.mark.parametrize("every", [2, 3, 7, 1000])
def test_every_so_many_ticks_hold_what_the_whole_run_held_then(whole: Trace, every: int):
    run = run_in_memory(shipped(FORCE, SHORT), every)
    np.testing.assert_array_equal(run.values, whole.values[::every], strict=True)
    # products of the same numbers in another order
    np.testing.assert_allclose(run.t, whole.t[::every], rtol=1e-15)
    for key in whole.fields():
        topic = key.partition(".")[0]
        np.testing.assert_array_equal(run.held(key), whole.held(key)[::every], strict=True)
        both = np.isin(whole.time(topic), run.time(topic))
        np.testing.assert_array_equal(run[key], whole[key][both], strict=True)
        assert np.count_nonzero(both) == len(run.time(topic)) > 0


def test_between_two_samples_the_last_one_holds(whole: Trace):
    F_z = whole["controller.F_z"]
    assert whole.time("controller")[1] == 2e-3
    np.testing.assert_array_equal(whole.held("controller.F_z"), np.repeat(F_z, 2)[: len(whole.t)])
    assert whole.held("plant.F_ee_B").shape == (len(whole.t), 3)


def test_of_some_signals_only_these_are_kept(whole: Trace):
    some = ("controller.triggered", "drive/2.theta_m", "plant.p_B")
    run = run_in_memory(shipped(FORCE, SHORT), only=some)
    assert set(run.fields()) == set(some)
    assert run.values.shape == (len(whole.t), 5)
    for key in some:
        np.testing.assert_array_equal(run[key], whole[key], strict=True)
    np.testing.assert_array_equal(run.of_drives("theta_m")[:, 0], whole["drive/2.theta_m"])


def test_what_was_not_kept_is_refused_with_the_nearest_name(whole: Trace):
    with pytest.raises(UnknownSeries, match=r"no series 'plant.p_A'; did you mean 'plant.p_B'"):
        whole["plant.p_A"]
    with pytest.raises(UnknownSeries, match=r"no series 'drive_1.theta_m'; did you mean 'drive/1.theta_m'"):
        whole.held("drive_1.theta_m")
    with pytest.raises(UnknownSeries, match=r"no topic 'plan'; did you mean 'plant'"):
        whole.time("plan")


def test_what_three_drives_tell_stands_side_by_side_and_what_none_tells_is_nothing(whole: Trace):
    joints = np.stack([whole[f"drive/{i}.theta_m"] for i in (1, 2, 3)], axis=1)
    np.testing.assert_array_equal(whole.of_drives("theta_m"), joints)
    assert whole.of_drives("temperature").shape == (len(whole.t), 0)


def test_of_a_run_that_failed_there_is_what_its_recording_holds(root: Path, tmp_path: Path):
    fmu = faulty_drive(root, tmp_path)
    experiment = shipped(
        "fig4_position", "duration_s=2", f"drive.joint_2.fmu='{fmu}'", "drive.joint_2.parameters.droop=1"
    )
    (tmp_path / "run").mkdir()
    with pytest.raises(ComponentFailed, match="fmi2Error"):
        execute(experiment, tmp_path / "run")
    run = Trace()
    with assemble(experiment) as assembly:
        done = simulate(assembly, experiment.duration_ticks, [run])
    assert done.failure is not None and done.simulation.culprit == "drive_2"
    assert_same(run, read(tmp_path / "run" / "run.mcap.partial"))
    with pytest.raises(ComponentFailed, match="fmi2Error"):
        run_in_memory(shorten(experiment, 1.5))
