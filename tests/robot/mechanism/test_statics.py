import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.robot.mechanism.poses import GEOMETRY, HOME, TURN, height_range, reachable_poses, triple, working_poses
from twin.kernel.errors import InputRefused
from twin.robot.mechanism.geometry import distal_link
from twin.robot.mechanism.kinematics import SingularPose, jacobian, joint_angles
from twin.robot.mechanism.statics import end_effector_force, joint_torques, leg_force
from twin.robot.mechanism.unreachable import Unreachable


@given(working_poses, triple)
def test_leg_by_leg_statics_equal_the_transposed_jacobian(p_B, tau_l):
    J = jacobian(GEOMETRY, p_B)
    F_ee_B = end_effector_force(GEOMETRY, joint_angles(GEOMETRY, p_B), tau_l)
    # a few roundings (2.2e-16 each) of the three leg forces that are summed
    legs = np.linalg.norm(J * tau_l[:, None], axis=1).sum()
    np.testing.assert_allclose(F_ee_B, J.T @ tau_l, rtol=0, atol=4e-15 * legs)


@given(working_poses, triple, triple)
def test_wrench_and_joint_torques_do_equal_work(p_B, tau_l, v):
    step = 1e-6
    theta_l = joint_angles(GEOMETRY, p_B)
    ahead, behind = joint_angles(GEOMETRY, [p_B + step * v, p_B - step * v])
    F_ee_B = end_effector_force(GEOMETRY, theta_l, tau_l)
    # central differences over 1e-6 m: truncation |J|^3 step^2 and cancellation 1e-15/step, both about 1e-8
    assert np.dot(F_ee_B, v) == pytest.approx(np.dot(tau_l, ahead - behind) / (2.0 * step), abs=1e-7)


@given(reachable_poses(), triple, st.sampled_from([0, 1, 2]))
def test_a_distal_link_pulls_and_pushes_only_along_itself(p_B, tau_l, leg):
    theta = joint_angles(GEOMETRY, p_B)[leg]
    x, y, z = p_B
    force = np.array(leg_force(GEOMETRY, leg, theta, x, y, z, tau_l[leg]))
    link = np.array(distal_link(GEOMETRY, leg, np.cos(theta), np.sin(theta), *p_B)) / GEOMETRY.l_b
    # rounding of unit vectors, relative to the force
    np.testing.assert_allclose(np.cross(link, force), 0.0, rtol=0, atol=1e-15 + 1e-14 * float(np.linalg.norm(force)))


@given(working_poses, triple)
def test_joint_torques_undo_the_end_effector_force(p_B, tau_l):
    F_ee_B = end_effector_force(GEOMETRY, joint_angles(GEOMETRY, p_B), tau_l)
    # 1e-14: rounding times cond(J) <= 2.6
    np.testing.assert_allclose(joint_torques(GEOMETRY, p_B, F_ee_B), tau_l, rtol=0, atol=1e-14)


@given(working_poses, triple)
def test_turning_the_torques_by_one_leg_turns_the_force_by_120_degrees(p_B, tau_l):
    theta_l = joint_angles(GEOMETRY, p_B)
    turned = end_effector_force(GEOMETRY, np.roll(theta_l, 1), np.roll(tau_l, 1))
    # 1e-12 N: forces up to 100 N through the turned angles
    np.testing.assert_allclose(turned, TURN @ end_effector_force(GEOMETRY, theta_l, tau_l), rtol=0, atol=1e-12)


def test_equal_torques_of_an_eighth_newton_metre_press_with_5_newton_at_home():
    tau_l = joint_torques(GEOMETRY, HOME, (0.0, 0.0, -5.0))
    # the reference value is given to 1 mN m
    np.testing.assert_allclose(tau_l, 0.125, rtol=0, atol=5e-4)


def test_positive_torque_pushes_the_platform_down():
    F_ee_B = end_effector_force(GEOMETRY, joint_angles(GEOMETRY, HOME), (0.1, 0.1, 0.1))
    assert F_ee_B[2] < 0.0


def test_a_batch_equals_its_single_poses_and_torques_broadcast():
    p_B = np.random.default_rng(4).uniform([-0.03, -0.03, -0.13], [0.03, 0.03, -0.085], (4, 5, 3))
    theta_l, tau_l = joint_angles(GEOMETRY, p_B), np.array([0.1, -0.2, 0.3])
    batch = end_effector_force(GEOMETRY, theta_l, tau_l)
    torques = joint_torques(GEOMETRY, p_B, batch)
    for index in np.ndindex(4, 5):
        np.testing.assert_array_equal(batch[index], end_effector_force(GEOMETRY, theta_l[index], tau_l))
        np.testing.assert_array_equal(torques[index], joint_torques(GEOMETRY, p_B[index], batch[index]))


def test_a_stretched_leg_gives_no_force():
    # theta_l from the closed form: at the lowest height on the axis both links of each leg are in line
    lowest, _ = height_range(GEOMETRY, 0.0, 0.0)
    stretched = np.arctan2(-lowest, -(GEOMETRY.a - GEOMETRY.b))
    with pytest.raises(SingularPose, match="leg 1 is stretched or folded"):
        end_effector_force(GEOMETRY, [stretched] * 3, (0.1, 0.1, 0.1))


def test_joint_torques_are_refused_where_the_distal_links_lie_in_one_plane():
    flat = GEOMETRY._replace(l_b=GEOMETRY.a - GEOMETRY.b + GEOMETRY.l_a * np.cos(0.35))
    with pytest.raises(SingularPose, match="one plane"):
        joint_torques(flat, (0.0, 0.0, -GEOMETRY.l_a * np.sin(0.35)), (0.0, 0.0, -1.0))


def test_angles_that_do_not_close_are_refused():
    with pytest.raises(Unreachable):
        end_effector_force(GEOMETRY._replace(l_b=0.07), (0.0, 0.0, 0.0), (0.1, 0.1, 0.1))


def test_torques_that_are_not_finite_are_refused():
    with pytest.raises(InputRefused, match="tau_l"):
        end_effector_force(GEOMETRY, joint_angles(GEOMETRY, HOME), (0.1, np.inf, 0.1))
