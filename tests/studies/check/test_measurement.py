"""Numbers of runs whose answers are known."""

import numpy as np
import pytest

from tests.laws.runs import shipped
from tests.studies.check.traces import EXPERIMENT, measuring, t, trace
from twin.kernel.errors import InputRefused
from twin.robot.assembly.assemble import assemble
from twin.robot.experiment.experiment import Experiment, shorten
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.mechanism.kinematics import joint_angles
from twin.robot.run.trace import run_in_memory
from twin.studies.check.measurement import REFERENCE_THETA_L, Signals, measure_signals, refuse_unknown

FAULT = "fault=[{kind='belief_eta', onset_s=0.2, magnitude_factor=0.9}]"


def test_an_index_picks_a_component_and_a_minus_turns_it_round():
    p_B = np.stack([t, 2.0 * t, 3.0 * t], axis=1)
    run = trace({"plant.p_B": p_B, "controller.on": t > 1.0}, {"plant.p_B": "m", "controller.on": "1"})
    np.testing.assert_array_equal(run["-plant.p_B[2]"], -3.0 * t)
    np.testing.assert_array_equal(run["plant.p_B"], p_B)
    assert (run.unit("-plant.p_B[2]"), run.unit("controller.on"), run.unit(f"{REFERENCE_THETA_L}[0]")) == (
        "m",
        "1",
        "rad",
    )


def test_of_a_sampled_component_there_is_what_held_at_every_tick_as_a_number():
    experiment = shorten(shipped("step_z_air"), 0.2)
    run = run_in_memory(experiment)
    signals = Signals(run, geometry_of(experiment.controller.model))
    assert signals["controller.triggered"].dtype == float
    assert len(signals["-controller.triggered"]) == len(signals["controller.F_z"]) == len(signals.t) == 201
    expected = joint_angles(geometry_of(experiment.controller.model), run.held("controller.p_ref_B"))
    np.testing.assert_array_equal(signals[f"{REFERENCE_THETA_L}[1]"], expected[:, 1])


def refuse(signal: str) -> None:
    spread = {"kind": "spread", "name": "s", "signal": signal}
    with assemble(shipped("pressing", FAULT)) as assembly:
        refuse_unknown(measuring(spread), assembly.system)


@pytest.mark.parametrize("signal", ["plant.p_B[2]", "drive/1.theta_m", "fault/1.value", "reference.theta_l[0]"])
def test_what_a_recording_of_the_run_names_can_be_measured(signal: str):
    refuse(signal)


@pytest.mark.parametrize(
    ("signal", "said"),
    [
        ("fault/2.value", "no such signal; did you mean 'fault/1.value'?"),
        ("plant.p_B", r"it has 3 components; expected \[0\] to \[2\]"),
        ("controller.F_z[0]", "it has 1 components; expected no index"),
    ],
)
def test_what_it_does_not_name_is_refused(signal: str, said: str):
    with pytest.raises(InputRefused, match=said):
        refuse(signal)


STEP = {"kind": "step", "name": "z", "signal": "plant.z", "reference": "controller.z", "begin_s": 1.0}
METRES = {"plant.z": "m", "controller.z": "m"}
# trapezoids and crossings of a smooth curve sampled at 1 ms
SAMPLED = 2e-3


def numbers(experiment: Experiment, run: Signals) -> dict[str, float]:
    return {name: metric.value for name, metric in measure_signals(experiment, run).metrics.items()}


def step_at_1() -> np.ndarray:
    return (t >= 1.0).astype(float)


def lagging(T: float = 0.5) -> np.ndarray:
    return np.where(t >= 1.0, 1.0 - np.exp(-(t - 1.0) / T), 0.0)


def test_a_first_order_lag_has_the_numbers_of_the_textbook():
    found = numbers(measuring(STEP), trace({"plant.z": lagging(), "controller.z": step_at_1()}, METRES))
    assert found["z.delay_time"] == pytest.approx(0.5 * np.log(2.0), abs=SAMPLED)
    assert found["z.rise_time"] == pytest.approx(0.5 * np.log(9.0), abs=SAMPLED)
    assert found["z.settling_time_2"] == pytest.approx(0.5 * np.log(50.0), abs=SAMPLED)
    assert found["z.settling_time_5"] == pytest.approx(0.5 * np.log(20.0), abs=SAMPLED)
    assert found["z.IAE"] == pytest.approx(0.5, abs=SAMPLED)
    assert found["z.ISE"] == pytest.approx(0.25, abs=SAMPLED)
    assert found["z.ITAE"] == pytest.approx(0.25, abs=SAMPLED)


def test_a_minus_turns_a_signal_round():
    down = {**STEP, "signal": "-plant.z"}
    found = numbers(measuring(down), trace({"plant.z": -lagging(), "controller.z": step_at_1()}, METRES))
    assert found["z.peak"] == pytest.approx(1.0, abs=1e-6)
    assert found["z.steady_state_error"] == pytest.approx(0.0, abs=1e-6)


def test_a_response_that_hunts_within_5_percent_has_no_settling_time_to_2():
    hunting = lagging() + 0.03 * np.sin(20.0 * t) * step_at_1()
    found = numbers(measuring(STEP), trace({"plant.z": hunting, "controller.z": step_at_1()}, METRES))
    assert "z.settling_time_5" in found and "z.settling_time_2" not in found


def test_a_constant_delay_is_the_lag():
    sine, late = np.sin(t), np.sin(t - 0.25)
    lag = {"kind": "lag", "name": "z", "signal": "plant.z", "reference": "controller.z"}
    found = numbers(measuring(lag), trace({"plant.z": late, "controller.z": sine}, METRES))
    # over no whole number of waves
    assert found["z.lag"] == pytest.approx(0.25, abs=1e-5)


def test_errors_spread_and_onset_are_those_of_the_definition():
    error = np.where(t < 5.0, 3.0, 4.0)
    run = trace(
        {"plant.z": -error, "controller.z": 0.0 * t, "controller.on": t >= 2.0}, {**METRES, "controller.on": "1"}
    )
    found = numbers(
        measuring(
            {"kind": "tracking", "name": "e", "signal": "plant.z", "reference": "controller.z"},
            {"kind": "spread", "name": "s", "signal": "plant.z", "until_s": 9.999},
            {"kind": "onset", "name": "on", "signal": "controller.on"},
        ),
        run,
    )
    # one sample of ten thousand more on one side
    assert found["e.rms_error"] == pytest.approx(np.sqrt(12.5), rel=1e-4)
    assert found["e.max_error"] == 4.0
    assert (found["s.mean"], found["s.std"]) == pytest.approx((-3.5, 0.5))
    assert found["on.time"] == 2.0


def test_a_circle_too_small_is_off_its_path_by_the_difference():
    def circle(radius: float) -> np.ndarray:
        return np.stack([radius * np.cos(t), radius * np.sin(t), 0.0 * t], axis=1)

    path = {"kind": "path", "name": "p"}
    vectors = {"plant.p_B": circle(0.9), "controller.p_ref_B": circle(1.0)}
    found = numbers(measuring(path), trace(vectors, dict.fromkeys(vectors, "m")))
    # the path is a polygon with corners 1 mrad apart
    assert (found["p.rms_error"], found["p.max_error"]) == pytest.approx((0.1, 0.1), abs=1e-6)


def test_work_is_torque_times_angle_and_travel_the_integral_of_the_commanded_speed():
    back_and_forth = np.where(t < 5.0, t, 10.0 - t)
    vectors = {
        "controller.omega_ref": np.stack([np.where(t < 5.0, 1.0, -1.0), 0.0 * t, 0.0 * t], axis=1),
        "plant.tau_load": np.stack([2.0 + 0.0 * t, 0.0 * t, 0.0 * t], axis=1),
        **{f"drive/{i}.theta_m": back_and_forth for i in (1, 2, 3)},
    }
    found = numbers(measuring({"kind": "effort", "name": "m"}), trace(vectors, dict.fromkeys(vectors, "1")))
    # the speed turns round within a sample
    assert found["m.commanded_travel"] == pytest.approx(10.0, abs=SAMPLED)
    assert found["m.work_delivered"] == pytest.approx(10.0, abs=SAMPLED)
    assert found["m.work_returned"] == pytest.approx(10.0, abs=SAMPLED)


@pytest.mark.parametrize(
    ("y", "reference", "units", "said"),
    [
        (t, step_at_1(), METRES, "has not settled"),
        (0.0 * t, step_at_1(), METRES, "no response to the step"),
        (lagging(), t, METRES, "still moves after the step"),
        (lagging(), step_at_1(), {"plant.z": "m", "controller.z": "N"}, "plant.z is in m, but its reference"),
    ],
)
def test_a_step_that_means_nothing_is_refused_with_the_name_of_its_measure(y, reference, units, said):
    with pytest.raises(InputRefused, match=rf'\[\[measure\]\] "z": .*{said}'):
        measure_signals(measuring(STEP), trace({"plant.z": y, "controller.z": reference}, units))


def test_a_step_looked_for_when_it_is_over_is_refused_rather_than_measured_from_there():
    run = trace({"plant.z": lagging(), "controller.z": step_at_1()}, METRES)
    with pytest.raises(InputRefused, match=r"controller.z makes no step at 1.2 s; set begin_s to when it does"):
        measure_signals(measuring({**STEP, "begin_s": 1.2}), run)
    with pytest.raises(InputRefused, match=r"controller.z still moves after the step at 0.9 s"):
        measure_signals(measuring({**STEP, "begin_s": 0.9}), run)


@pytest.mark.parametrize(
    ("measure", "said"),
    [
        ({**STEP, "until_s": 1.01}, "measures for less than 0.02 s"),
        ({**STEP, "kind": "tracking", "until_s": 1.0005}, "fewer than two ticks from begin_s to until_s"),
    ],
)
def test_a_window_too_short_for_its_measure_is_refused(measure: dict, said: str):
    run = trace({"plant.z": lagging(), "controller.z": step_at_1()}, METRES)
    with pytest.raises(InputRefused, match=said):
        measure_signals(measuring(measure), run)


def test_without_excitation_there_is_no_lag_and_no_path_and_both_are_told():
    run = trace({"plant.z": np.sin(t), "controller.z": 0.0 * t, "controller.p_ref_B": np.zeros((len(t), 3))}, METRES)
    lag = {"kind": "lag", "name": "l", "signal": "plant.z", "reference": "controller.z"}
    with pytest.raises(InputRefused, match=r"(?s)controller.z does not move.*does not move, so it has no path"):
        measure_signals(measuring(lag, {"kind": "path", "name": "p"}), run)


def test_a_lag_of_the_longest_or_more_and_an_onset_that_never_comes_are_refused():
    run = trace({"plant.z": np.sin(t - 0.5), "controller.z": np.sin(t)}, METRES)
    lag = {"kind": "lag", "name": "l", "signal": "plant.z", "reference": "controller.z", "longest_s": 0.2}
    with pytest.raises(InputRefused, match="lags by longest_s"):
        measure_signals(measuring(lag), run)
    with pytest.raises(InputRefused, match="never true"):
        measure_signals(measuring({"kind": "onset", "name": "o", "signal": "plant.z", "until_s": 0.1}), run)


def test_an_experiment_without_measures_says_so():
    with pytest.raises(InputRefused, match=r"step_z_air: has no \[\[measure\]\] tables"):
        measure_signals(measuring(), trace({}, {}))
    assert EXPERIMENT.measures


def test_an_oscillation_is_that_of_its_window_and_what_rests_has_no_frequency():
    y = np.where(t < 5.0, 1.0, 1.0 + 0.25 * np.sin(2.0 * np.pi * 12.0 * t))
    run = trace({"plant.z": y}, METRES)
    kind = {"kind": "oscillation", "signal": "plant.z"}
    found = numbers(measuring({**kind, "name": "rest", "until_s": 4.9}, {**kind, "name": "swing", "begin_s": 5.0}), run)
    assert found["rest.amplitude"] < 1e-12 and "rest.frequency" not in found
    assert found["swing.amplitude"] == pytest.approx(0.25, rel=0.004)
    assert found["swing.frequency"] == pytest.approx(12.0, abs=0.03)
    with pytest.raises(InputRefused, match=r"measures for 1 s; expected 4 periods of lowest_Hz = 1, which are 4 s"):
        numbers(measuring({**kind, "name": "short", "until_s": 1.0}), run)
