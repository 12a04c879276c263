import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.robot.mechanism.statics import dead_zone, deflection, directed_load_torque, load_torque, motor_load_torque

deflecteds = st.floats(-1.0, 1.0)
speeds = st.floats(-10.0, 10.0)
stiffnesses = st.floats(0.1, 10.0)
ratios = st.floats(0.5, 10.0)
efficiencies = st.floats(0.3, 1.0)
half_widths = st.floats(0.0, 0.1)


@given(stiffnesses, ratios, deflecteds, speeds, speeds)
def test_lossless_transmission_stores_what_the_motor_gives_and_the_load_does_not_take(k_s, N, d, omega_m, thetadot_l):
    motor_power = motor_load_torque(k_s, d) * omega_m
    load_power = load_torque(k_s, N, 1.0, d) * thetadot_l
    stored_power = k_s * d * deflection(omega_m, thetadot_l, N)  # d/dt of k_s d^2 / 2
    # rounding of products of up to 1e3 W
    assert motor_power == pytest.approx(load_power + stored_power, rel=1e-12, abs=1e-12)


@given(stiffnesses, ratios, efficiencies, deflecteds)
def test_motor_carries_the_load_torque_over_ratio_and_efficiency(k_s, N, eta, d):
    # rounding of three products
    assert motor_load_torque(k_s, d) == pytest.approx(load_torque(k_s, N, eta, d) / (N * eta), rel=1e-14)


@given(ratios, st.floats(-3.0, 3.0))
def test_spring_is_unloaded_where_the_motor_turned_ratio_times_the_load(N, theta_l):
    assert deflection(N * theta_l, theta_l, N) == 0.0


@given(deflecteds, half_widths)
def test_backlash_is_symmetric(d, half_width):
    assert dead_zone(-d, half_width) == -dead_zone(d, half_width)


@given(st.floats(-1.0, 1.0), half_widths)
def test_backlash_passes_nothing_inside_and_the_rest_outside(share, half_width):
    assert dead_zone(share * half_width, half_width) == 0.0
    # rounding of numbers around one
    assert dead_zone(1.0 + half_width, half_width) == pytest.approx(1.0, rel=1e-15)


@given(deflecteds, deflecteds, half_widths)
def test_backlash_never_magnifies_a_change(d, other, half_width):
    change = abs(dead_zone(d, half_width) - dead_zone(other, half_width))
    # 1e-15: rounding of numbers around one
    assert change <= abs(d - other) + 1e-15


def test_without_backlash_the_deflection_passes_unchanged():
    assert dead_zone(0.3, 0.0) == 0.3


def test_an_undefined_deflection_is_not_hidden_by_backlash():
    assert math.isnan(dead_zone(math.nan, 0.1))


@given(stiffnesses, ratios, efficiencies, deflecteds, speeds, st.floats(1e-4, 1.0))
def test_directed_losses_never_create_power(k_s, N, eta, d, thetadot_l, rate):
    into_belt = motor_load_torque(k_s, d) * N * thetadot_l
    out_of_belt = directed_load_torque(k_s, N, eta, d, thetadot_l, rate) * thetadot_l
    # 1e-15 relative: rounding where the factor is one
    assert into_belt - out_of_belt >= -1e-15 * abs(into_belt)


@given(stiffnesses, ratios, efficiencies, deflecteds)
def test_directed_losses_multiply_when_driving_and_divide_when_driven(k_s, N, eta, d):
    forward = math.copysign(1.0, d)
    tau_r = k_s * d
    # 20 times the blending rate: tanh is 1 in floating point, rounding of powers is left
    driving = directed_load_torque(k_s, N, eta, d, 20.0 * forward, 1.0)
    driven = directed_load_torque(k_s, N, eta, d, -20.0 * forward, 1.0)
    assert driving == pytest.approx(N * tau_r * eta, rel=1e-14)
    assert driven == pytest.approx(N * tau_r / eta, rel=1e-14)


@given(stiffnesses, ratios, deflecteds, speeds)
def test_without_losses_the_direction_does_not_matter(k_s, N, d, thetadot_l):
    # exact: any power of one is one
    assert directed_load_torque(k_s, N, 1.0, d, thetadot_l, 0.01) == N * (k_s * d)


@given(stiffnesses, ratios, efficiencies, deflecteds)
def test_at_rest_the_directed_loss_vanishes(k_s, N, eta, d):
    assert directed_load_torque(k_s, N, eta, d, 0.0, 0.01) == N * (k_s * d)
