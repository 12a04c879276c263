import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.monitor.motions import BELIEF, DT, GEOMETRY, angles
from tests.plant.states import positions
from twin.monitor.resolution import press_wind_up, resolution
from twin.robot.forward_kinematics import position
from twin.robot.statics import end_effector_force

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
    assert one.force_rate * DT == np.float64(one.force) or abs(one.force_rate * DT / one.force - 1.0) < 1e-12


@given(positions(), st.floats(0.0, 20.0))
def test_a_press_winds_the_springs_up_as_the_robot_at_rest_has_them(p_B, F_z):
    theta_m, theta_l = angles(p_B[None], np.array([[0.0, 0.0, -F_z]]))
    # rounding; where a spring is unloaded the dead zone's side is open
    assert press_wind_up(BELIEF, p_B, F_z) >= np.abs(theta_m - BELIEF.N * theta_l).max() - 1e-12
    assert press_wind_up(BELIEF, p_B, F_z) <= np.abs(theta_m - BELIEF.N * theta_l).max() + BELIEF.backlash + 1e-12


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_a_count_on_a_spring_of_absurd_stiffness_is_worth_more_than_any_limit():
    assert resolution(BELIEF._replace(k_s=1e307), np.array([0.0, 0.0, -0.1]), DT).force_rate == np.inf
