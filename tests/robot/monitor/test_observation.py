"""What the monitor makes of encoder messages, by its compiled functions alone."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.robot.monitor.motions import BELIEF, DT, GEOMETRY, angles
from tests.robot.plant.states import positions
from twin.robot.mechanism.kinematics import position
from twin.robot.mechanism.statics import dead_zone, end_effector_force, load_torque
from twin.robot.monitor.component import BELIEF_RECORD as BELIEF_RECORD
from twin.robot.monitor.component import (
    OBSERVATION_RECORD,
    low_pass_share,
    observe_joints,
    observe_platform,
    press_deflection,
    resolution,
)

signs = st.tuples(*[st.sampled_from((-1.0, 1.0))] * 3).map(np.array)


@given(positions(), signs)
def test_one_count_on_every_encoder_is_worth_at_most_the_resolution(p_B, sign):
    one = resolution(BELIEF, p_B, DT)
    theta_l = angles(p_B[None], np.zeros((1, 3)))[1][0]
    joint = 2.0 * np.pi / BELIEF.joint_counts
    moved = position(GEOMETRY, theta_l + sign * joint) - p_B
    # the kinematics are curved: 1 % over a count
    assert np.linalg.norm(moved) <= 1.01 * one.position
    tau_l = sign * BELIEF.k_s * BELIEF.N * BELIEF.eta * (2.0 * np.pi / BELIEF.motor_counts + BELIEF.N * joint)
    # rounding
    assert np.linalg.norm(end_effector_force(GEOMETRY, theta_l, tau_l)) <= one.force * (1.0 + 1e-12)
    motor = 2.0 * np.pi / BELIEF.motor_counts
    per_sample = (one.motor_speed, motor), (one.jump, one.deflection), (one.force_rate, one.force)
    for rate, count in (*per_sample, (one.velocity, one.position)):
        assert rate * DT == pytest.approx(count, rel=1e-12)


@given(positions(), st.floats(0.0, 20.0))
def test_a_press_winds_the_springs_up_as_the_robot_at_rest_has_them(p_B, F_z):
    theta_m, theta_l = angles(p_B[None], np.array([[0.0, 0.0, -F_z]]))
    # rounding; where a spring is unloaded the dead zone's side is open
    assert press_deflection(BELIEF, p_B, F_z) >= np.abs(theta_m - BELIEF.N * theta_l).max() - 1e-12
    assert press_deflection(BELIEF, p_B, F_z) <= np.abs(theta_m - BELIEF.N * theta_l).max() + BELIEF.backlash + 1e-12


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_count_on_a_spring_of_absurd_stiffness_is_worth_more_than_any_limit():
    assert resolution(BELIEF._replace(k_s=1e307), np.array([0.0, 0.0, -0.1]), DT).force_rate == np.inf


PRESSING = np.array([[1.0, -2.0, -7.0]])


def seen_at_rest(theta_m, theta_l) -> np.void:
    """A monitor that has seen nothing yet, with the joints that stand so."""
    seen = np.zeros(1, dtype=OBSERVATION_RECORD)[0]
    seen["theta_m"], seen["theta_l"] = theta_m, theta_l
    deflection = np.array([dead_zone(d, BELIEF.backlash) for d in theta_m - BELIEF.N * theta_l])
    seen["tau_l"] = [load_torque(BELIEF.k_s, BELIEF.N, BELIEF.eta, d) for d in deflection]
    return seen


def test_a_robot_that_presses_from_the_first_message_on_has_no_growing_force():
    theta_m, theta_l = angles(np.array([[0.0, 0.01, -0.105]]), PRESSING)
    seen, belief = seen_at_rest(theta_m[0], theta_l[0]), np.array([tuple(BELIEF)], dtype=BELIEF_RECORD)[0]
    share = low_pass_share(20.0, DT)
    assert observe_platform(belief, seen, share, DT)
    # rounding of sums of torques below 1 N m over arms of 0.1 m
    np.testing.assert_allclose(seen["F_ee_B"], PRESSING[0], rtol=0, atol=1e-9)
    assert abs(seen["force"] - np.linalg.norm(PRESSING)) < 1e-9
    seen["started"] = 1
    assert observe_platform(belief, seen, share, DT)
    # the same rounding, over 2 ms
    assert abs(seen["force_rate"]) < 1e-6


def test_after_its_time_constant_a_low_pass_has_taken_over_all_but_one_part_in_e():
    # rounding
    assert abs(low_pass_share(20.0, 1.0 / (2.0 * math.pi * 20.0)) - (1.0 - 1.0 / math.e)) < 1e-15


def test_speeds_of_shafts_that_start_to_turn_rise_as_a_first_order_lag():
    """Motor, joint on the motor's side, command: one low-pass for all, so that they can be compared."""
    seen, belief = np.zeros(1, dtype=OBSERVATION_RECORD)[0], np.array([tuple(BELIEF)], dtype=BELIEF_RECORD)[0]
    share, counts, n = low_pass_share(20.0, DT), np.array([300.0, -200.0, 100.0]), 30
    sent = 2.0 * math.pi / BELIEF.motor_counts * counts / DT
    share_of_joint = BELIEF.joint_counts / (BELIEF.motor_counts * BELIEF.N)
    for k in range(n + 1):
        observe_joints(belief, seen, share, DT, k * counts, k * counts * share_of_joint, sent)
        seen["started"] = 1
    # rounding of 30 sums of numbers below 1000
    for name in ("omega_m", "omega_l", "omega_cmd"):
        np.testing.assert_allclose(seen[name], sent * (1.0 - (1.0 - share) ** n), rtol=1e-9, err_msg=name)
