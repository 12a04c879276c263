"""What the monitor makes of encoder messages, by its compiled functions alone."""

import math

import numpy as np

from tests.monitor.motions import BELIEF, DT, angles
from twin.monitor.belief import BELIEF as BELIEF_RECORD
from twin.monitor.observation import SEEN, low_pass_share, observe_joints, observe_platform
from twin.robot.sea import dead_zone, load_torque

PRESSING = np.array([[1.0, -2.0, -7.0]])


def seen_at_rest(theta_m, theta_l) -> np.void:
    """A monitor that has seen nothing yet, with the joints that stand so."""
    seen = np.zeros(1, dtype=SEEN)[0]
    seen["theta_m"], seen["theta_l"] = theta_m, theta_l
    wind_up = np.array([dead_zone(d, BELIEF.backlash) for d in theta_m - BELIEF.N * theta_l])
    seen["tau_l"] = [load_torque(BELIEF.k_s, BELIEF.N, BELIEF.eta, d) for d in wind_up]
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
    seen, belief = np.zeros(1, dtype=SEEN)[0], np.array([tuple(BELIEF)], dtype=BELIEF_RECORD)[0]
    share, counts, n = low_pass_share(20.0, DT), np.array([300.0, -200.0, 100.0]), 30
    sent = 2.0 * math.pi / BELIEF.motor_counts * counts / DT
    share_of_joint = BELIEF.joint_counts / (BELIEF.motor_counts * BELIEF.N)
    for k in range(n + 1):
        observe_joints(belief, seen, share, DT, k * counts, k * counts * share_of_joint, sent)
        seen["started"] = 1
    # rounding of 30 sums of numbers below 1000
    for name in ("omega_m", "omega_l", "omega_cmd"):
        np.testing.assert_allclose(seen[name], sent * (1.0 - (1.0 - share) ** n), rtol=1e-9, err_msg=name)
