"""What is broken on purpose and a little is noticed, and called by what got worse."""

import pytest

from tests.conftest import ROOT
from tests.laws.runs import EXPERIMENTS
from twin.robot.assembly.load import load_experiment
from twin.studies.check.baseline import read_baseline
from twin.studies.check.measurement import measure_signals, run_for_measures
from twin.studies.check.verdict import CheckRow, verdict


def broken(name: str, drive: str, override: str) -> dict[str, CheckRow]:
    """What deviates from the repository's baseline with `override`."""
    experiment = load_experiment(EXPERIMENTS / f"{name}.toml", [override], drive)
    baseline = read_baseline(ROOT / f"tests/baselines/{name}/{drive}.toml")
    return {
        row.name: row
        for row in verdict(
            experiment, drive, baseline, measure_signals(experiment, run_for_measures(experiment))
        ).deviations
    }


@pytest.mark.parametrize("drive", ["ideal_velocity", "pmsm_foc"])
def test_a_spring_2_percent_softer_than_believed_presses_less_than_it_should(drive: str):
    found = broken("step_force_scale", drive, "plant.k_s_Nm_per_rad=0.98")
    error = found["force.steady_state_error"]
    assert error.word == "worse" and error.now is not None and error.before is not None
    # 2 % of what the springs bear: 7 N of the scale less 2.2 N of the robot's own weight; a motor count is 0.03 N
    assert error.now - error.before == pytest.approx(0.02 * (7.0 - 2.2), abs=0.04)


@pytest.mark.parametrize("name", ["step_z_air", "step_joint_1", "track_line", "track_circle"])
@pytest.mark.parametrize(("gain", "word"), [(1.575, "better"), (1.425, "worse")])
def test_a_position_gain_5_percent_off_is_noticed(name: str, gain: float, word: str):
    found = broken(name, "pmsm_foc", f"controller.position.kp_per_s={gain}")
    follows = {row.name: row.word for row in found.values() if row.name.endswith(("rise_time", "rms_error", "lag"))}
    assert follows and set(follows.values()) == {word}


# the others: of the steps of the stepper no lag can be told, and 1 ms is just 2 % of the 49 ms of smart_servo
PROMPT = (
    "brushed_dc",
    "ideal_velocity",
    "modelica_dc",
    "pmsm_foc",
    "python_servo",
    "torque_motor_fmi3",
    "velocity_servo",
)


@pytest.mark.parametrize("drive", PROMPT)
def test_drives_that_hear_their_command_one_tick_late_are_noticed_by_their_lag(drive: str):
    found = broken("track_chirp", drive, "controller.delay_ticks=1")
    lag = found["drive.lag"]
    assert lag.word == "worse" and lag.now is not None and lag.before is not None
    # of a tick of 1 ms; the loop's answer to it makes another speed profile
    assert lag.now - lag.before == pytest.approx(1e-3, rel=0.1)
