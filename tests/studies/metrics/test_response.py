import numpy as np
import pytest

from twin.studies.metrics.response import first_time, overshoot, rise_time, settling_time, steepest_rise, within

t = np.linspace(0.0, 10.0, 10_001)
first_order = 1.0 - np.exp(-t)


def test_rise_time_of_a_first_order_lag_is_ln_9_time_constants():
    # two samples of 1 ms
    assert rise_time(t, first_order, 0.0, 1.0) == pytest.approx(np.log(9.0), abs=2e-3)


def test_settling_of_a_first_order_lag_is_minus_ln_of_the_band():
    assert settling_time(t, first_order, 1.0, 0.02) == pytest.approx(-np.log(0.02), abs=2e-3)


def test_what_leaves_the_band_at_the_end_never_settles():
    assert settling_time(t, t, 5.0, 1.0) == np.inf


def test_what_never_leaves_the_band_is_settled_from_the_start():
    assert settling_time(t, np.ones_like(t), 1.0, 0.1) == 0.0


def test_the_edge_of_the_band_belongs_to_it():
    times, y = np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.5, 1.5])
    assert settling_time(times, y, 1.0, 0.5) == 1.0


def test_overshoot_of_a_damped_oscillation_is_exp_of_minus_pi_zeta_over_root():
    zeta = 0.3
    omega = np.sqrt(1 - zeta**2)
    y = 1 - np.exp(-zeta * t) * (np.cos(omega * t) + zeta / omega * np.sin(omega * t))
    # the peak lies between samples: second order in 1 ms
    assert overshoot(y, 1.0) == pytest.approx(np.exp(-np.pi * zeta / omega), abs=1e-6)


def test_a_response_from_below_has_no_overshoot():
    assert overshoot(first_order, 1.0) == 0.0


def test_first_time_is_infinite_for_what_never_happens():
    assert first_time(t, t > 11.0) == np.inf
    assert first_time(t, t >= 5.0) == 5.0


def test_a_window_includes_its_ends():
    assert t[within(t, 2.0, 3.0)][[0, -1]].tolist() == [2.0, 3.0]


def test_half_a_nanosecond_outside_a_window_is_still_inside_and_a_whole_one_is_not():
    assert within(np.array([2.0 - 5e-10, 3.0 + 5e-10]), 2.0, 3.0).all()
    assert not within(np.array([2.0 - 1e-9, 3.0 + 1e-9]), 2.0, 3.0).any()


def test_the_steepest_rise_of_a_ramp_is_its_slope_and_of_a_step_its_height_over_the_span():
    # rounding of t
    assert steepest_rise(t, 3.0 * t, 0.2) == pytest.approx(3.0, rel=1e-9)
    assert steepest_rise(t, np.where(t > 5.0, 1.0, 0.0), 0.2) == pytest.approx(5.0, rel=1e-9)


def test_samples_shorter_than_the_span_have_no_rate():
    assert steepest_rise(t[:100], t[:100], 0.2) == np.inf
    assert steepest_rise(t[:1], t[:1], 0.2) == np.inf
