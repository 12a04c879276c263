import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.robot.controller.test_controller import GEOMETRY
from tests.robot.plant.states import positions
from twin.robot.controller.compliance import REST_SPEED, friction_force, load_torques
from twin.robot.controller.pid import PID_RECORD, Gains, accept, loop_record, low_pass_share, proposal, reset_loop
from twin.robot.mechanism.kinematics import jacobian

T_s = 2e-3
errors = st.lists(st.floats(-10.0, 10.0), min_size=1, max_size=30)


def at_rest(*gains):
    return np.array([loop_record(Gains(*gains))], dtype=PID_RECORD)[0]


def driven(pid, samples):
    """Outputs for error samples, every integral accepted."""
    outputs = []
    for e in samples:
        u, integral = proposal(pid, e, T_s)
        accept(pid, integral)
        outputs.append(u)
    return np.array(outputs)


@given(errors)
def test_proportional_loop_multiplies(samples):
    np.testing.assert_array_equal(driven(at_rest(3.0), samples), 3.0 * np.array(samples))


@given(errors)
def test_integral_is_the_sum_of_rectangles_and_includes_the_newest(samples):
    # rounding of sums of 30 numbers below 0.1
    np.testing.assert_allclose(driven(at_rest(0.0, 5.0), samples), 5.0 * T_s * np.cumsum(samples), rtol=0, atol=1e-14)


def test_a_proposal_that_is_not_accepted_leaves_the_integral():
    pid = at_rest(0.0, 5.0)
    proposal(pid, 1.0, T_s)
    u, _ = proposal(pid, 1.0, T_s)
    assert u == 5.0 * T_s


def test_first_sample_makes_no_derivative():
    u, _ = proposal(at_rest(0.0, 0.0, 2.0), 7.0, T_s)
    assert u == 0.0


@given(errors, errors)
def test_a_loop_that_has_rested_answers_as_if_nothing_had_been_before(before, samples):
    gains, pid = (2.0, 5.0, 0.1, 20.0), at_rest(2.0, 5.0, 0.1, 20.0)
    driven(pid, before)
    reset_loop(pid)
    assert pid == at_rest(*gains)
    np.testing.assert_array_equal(driven(pid, samples), driven(at_rest(*gains), samples))


@given(errors)
def test_unfiltered_derivative_is_the_difference_quotient(samples):
    expected = 2.0 * np.diff([samples[0], *samples]) / T_s
    # rounding of quotients of up to 2e4
    np.testing.assert_allclose(driven(at_rest(0.0, 0.0, 2.0), samples), expected, rtol=0, atol=1e-10)


@given(st.floats(0.5, 200.0), st.floats(-10.0, 10.0))
def test_filtered_derivative_of_a_ramp_rises_as_a_first_order_lag(corner, slope):
    n = np.arange(40)
    found = driven(at_rest(0.0, 0.0, 2.0, corner), slope * n * T_s)
    # the exact lag at the sampling times; rounding of quotients of up to 1e2
    expected = 2.0 * slope * (1.0 - np.exp(-2.0 * np.pi * corner * n * T_s))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-11)


@given(st.floats(0.1, 1000.0), st.floats(1e-5, 0.1), st.integers(1, 20))
def test_low_pass_shares_of_part_periods_make_up_that_of_the_whole(corner, h, parts):
    left = (1.0 - low_pass_share(corner, h / parts)) ** parts
    # rounding
    assert 1.0 - left == pytest.approx(low_pass_share(corner, h), rel=1e-9)
    assert low_pass_share(corner, h) == pytest.approx(1.0 - math.exp(-2.0 * math.pi * corner * h), rel=1e-12)


def test_corner_zero_means_no_filter():
    assert low_pass_share(0.0, T_s) == 1.0


newtons = st.floats(-10.0, 10.0)


@given(positions(), newtons, newtons, newtons)
def test_load_torques_do_the_work_of_the_force(p_B, F_x, F_y, F_z):
    J = jacobian(GEOMETRY, p_B)
    tau_l = load_torques(J.ravel(), F_x, F_y, F_z)
    # virtual work: J^T tau = F; rounding of forces below 20 N
    np.testing.assert_allclose(J.T @ tau_l, [F_x, F_y, F_z], rtol=0, atol=1e-13)
    np.testing.assert_allclose(tau_l, np.linalg.solve(J.T, [F_x, F_y, F_z]), rtol=0, atol=1e-13)


@given(st.floats(0.0, 1.0), st.floats(0.0, 10.0), st.floats(0.01, 0.2), st.floats(0.0, 2.0 * np.pi))
def test_friction_pulls_the_surface_along_with_mu_times_the_normal_force(mu, F_n, speed, angle):
    v = speed * np.array([np.cos(angle), np.sin(angle)])
    F = np.array(friction_force(mu, F_n, *v))
    # rounding
    assert abs(F[0] * v[1] - F[1] * v[0]) <= 1e-15
    assert F @ v >= 0.0
    # the fading takes (REST_SPEED/speed)^2/2 of it, 0.5 % at 10 mm/s; rounding of forces below 10 N
    assert mu * F_n * (1.0 - 0.5 * (REST_SPEED / speed) ** 2) - 1e-12 <= np.hypot(*F) <= mu * F_n + 1e-12


def test_friction_fades_out_at_rest_and_changes_sign_with_the_motion():
    assert friction_force(0.22, 5.0, 0.0, 0.0) == (0.0, 0.0)
    there, back = friction_force(0.22, 5.0, 0.0, 1e-4), friction_force(0.22, 5.0, 0.0, -1e-4)
    assert there[1] == -back[1] > 0.0
    # a tenth of the rest speed: a tenth of the friction, less 0.5 %
    assert there[1] == pytest.approx(0.1 * 0.22 * 5.0, rel=0.006)


def test_the_force_of_friction_never_jumps():
    v = np.linspace(-0.02, 0.02, 4001)
    F = np.array([friction_force(0.22, 5.0, x, 0.0)[0] for x in v])
    # nowhere steeper than at rest, mu F_n/REST_SPEED
    assert np.diff(F).max() <= 0.22 * 5.0 / REST_SPEED * (v[1] - v[0]) * (1.0 + 1e-9)
    assert np.diff(F).min() >= 0.0
