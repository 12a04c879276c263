"""Step responses with known answers."""

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.errors import InputRefused
from twin.studies.metrics.step import crossing_time, step_info

t = np.linspace(0.0, 20.0, 20_001)
# trapezoids, crossings and settling of a smooth curve at 1 ms: second order in the step, settling one sample
SAMPLE = 1e-3


def second_order(zeta: float) -> np.ndarray:
    omega = np.sqrt(1 - zeta**2)
    return 1 - np.exp(-zeta * t) * (np.cos(omega * t) + zeta / omega * np.sin(omega * t))


def test_a_first_order_lag_has_the_times_of_the_textbook():
    info = step_info(t, 1.0 - np.exp(-t), 0.0, 1.0)
    # the final value is a mean over the tail, 1e-8 short of 1
    assert info.rise_time == pytest.approx(np.log(9.0), abs=1e-6)
    assert info.delay_time == pytest.approx(np.log(2.0), abs=1e-6)
    assert info.settling_time_2 == pytest.approx(np.log(50.0), abs=SAMPLE)
    assert info.settling_time_5 == pytest.approx(np.log(20.0), abs=SAMPLE)
    assert info.overshoot == pytest.approx(0.0, abs=1e-7)


def test_a_first_order_lag_has_integrals_of_its_error_of_T_half_T_and_T_squared():
    info = step_info(t, 2.0 * (1.0 - np.exp(-t)), 0.0, 2.0)
    assert (info.IAE, info.ISE, info.ITAE) == pytest.approx((2.0, 2.0, 2.0), abs=1e-5)


def test_a_damped_oscillation_overshoots_by_exp_of_minus_pi_zeta_over_root_at_pi_over_omega():
    zeta = 0.3
    info = step_info(t, second_order(zeta), 0.0, 1.0)
    # what is left of the oscillation in the tail, and the peak between samples
    assert info.overshoot == pytest.approx(np.exp(-np.pi * zeta / np.sqrt(1 - zeta**2)), abs=2e-3)
    assert info.peak_time == pytest.approx(np.pi / np.sqrt(1 - zeta**2), abs=SAMPLE)


@pytest.mark.parametrize("zeta", [0.4, 0.7, 0.9])
def test_python_control_measures_the_same(zeta):
    theirs = control.step_info(control.tf([1.0], [1.0, 2.0 * zeta, 1.0]), T=t)
    ours = step_info(t, second_order(zeta), 0.0, 1.0)
    # it takes whole samples
    assert ours.rise_time == pytest.approx(theirs["RiseTime"], abs=2 * SAMPLE)
    # and the last sample for the final value, which is 7e-4 off the mean over the tail where little is damped
    assert ours.settling_time_2 == pytest.approx(theirs["SettlingTime"], abs=10 * SAMPLE)
    assert 100 * ours.overshoot == pytest.approx(theirs["Overshoot"], abs=0.05)
    assert ours.peak == pytest.approx(theirs["Peak"], abs=1e-3)


@given(st.floats(-5.0, 5.0), st.floats(0.1, 5.0), st.booleans())
def test_offset_size_and_direction_of_a_step_do_not_change_its_times(before, size, down):
    size = -size if down else size
    plain = step_info(t, second_order(0.5), 0.0, 1.0)
    other = step_info(t, before + size * second_order(0.5), before, before + size)
    assert other.rise_time == pytest.approx(plain.rise_time, abs=1e-9)
    assert other.overshoot == pytest.approx(plain.overshoot, abs=1e-9)
    assert other.steady_state_error == pytest.approx(size * plain.steady_state_error, abs=1e-9)


def test_a_response_that_ends_elsewhere_has_a_steady_state_error():
    info = step_info(t, 0.9 * (1.0 - np.exp(-t)), 0.0, 1.0)
    assert info.steady_state_error == pytest.approx(0.1, abs=1e-6)
    assert info.overshoot == pytest.approx(0.0, abs=1e-7)


def test_a_response_still_on_its_way_is_refused_rather_than_measured():
    early = t <= 2.0
    with pytest.raises(InputRefused, match=r"has not settled: in its last .* simulate longer"):
        step_info(t[early], 1.0 - np.exp(-t[early]), 0.0, 1.0)


def test_what_is_said_of_a_response_still_on_its_way_are_its_own_numbers():
    times = np.linspace(0.0, 10.0, 101)
    # a ramp to 1: its last tenth, 0.91 .. 1 at ten samples, has the mean 0.955; its last fifth begins at 8.1 s and 0.81
    with pytest.raises(InputRefused) as refused:
        step_info(times, 0.1 * times, 0.0, 1.0)
    assert str(refused.value) == (
        "the step response has not settled: in its last 1.9 s it is still 0.145 from its end, 15 % of the step, "
        "expected at most 5 %; simulate longer"
    )


def test_a_response_that_hunts_for_ever_has_no_settling_time_rather_than_one_at_its_very_end():
    # 3 % either way: within 5 % but never within 2 %
    info = step_info(t, 1.0 - np.exp(-t) + 0.03 * np.sin(20.0 * t), 0.0, 1.0)
    assert info.settling_time_2 == np.inf
    assert np.log(20.0) < info.settling_time_5 < np.log(50.0)


def test_no_answer_no_step_and_too_few_samples_are_refused():
    with pytest.raises(InputRefused, match="no answer to the step from 0 to 1"):
        step_info(t, np.zeros_like(t), 0.0, 1.0)
    with pytest.raises(InputRefused, match="no step"):
        step_info(t, np.zeros_like(t), 1.0, 1.0)
    with pytest.raises(InputRefused, match="5 samples"):
        step_info(t[:5], t[:5], 0.0, 1.0)


def test_a_crossing_lies_between_samples():
    assert crossing_time(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 3.0]), 2.0) == 1.5
    assert crossing_time(np.array([0.0, 1.0]), np.array([0.0, 1.0]), 2.0) == np.inf
    assert crossing_time(np.array([0.5, 1.0]), np.array([1.0, 1.0]), 0.5) == 0.5
