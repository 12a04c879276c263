import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.robot.mechanism.poses import GEOMETRY, HOME, MASSES, triple, working_poses
from twin.robot.mechanism.kinematics import joint_angles
from twin.robot.mechanism.statics import (
    G_ACCELERATION,
    arm_gravity_torque,
    end_effector_force,
    environment_force,
    joint_torques,
    leg_inertia,
    moving_mass,
    platform_weight,
)


def potential_energy(p_B):
    """Sum of m g z over the parts: rods at their middles, rod pairs half at A_i and half at the platform."""
    height_A = -GEOMETRY.l_a * np.sin(joint_angles(GEOMETRY, p_B))
    parts = MASSES.m_a * height_A / 2.0 + MASSES.m_b / 2.0 * height_A + MASSES.m_b / 2.0 * p_B[2]
    return G_ACCELERATION * (parts.sum() + MASSES.m_p * p_B[2])


def energy_gradient(p_B, step=1e-5):
    steps = step * np.eye(3)
    return np.array([potential_energy(p_B + s) - potential_energy(p_B - s) for s in steps]) / (2.0 * step)


@given(working_poses, triple)
def test_environment_carries_what_joints_and_weight_leave_over(p_B, tau_l):
    theta_l = joint_angles(GEOMETRY, p_B)
    F_ee_B = environment_force(GEOMETRY, MASSES, theta_l, p_B, tau_l)
    # 1e-8 N: central difference of the energy over 1e-5 m, truncation |J|^3 step^2 x 0.1 J
    expected = end_effector_force(GEOMETRY, theta_l, tau_l) - energy_gradient(p_B)
    np.testing.assert_allclose(F_ee_B, expected, rtol=0, atol=1e-6)


@given(working_poses)
def test_torques_that_carry_the_weight_leave_no_force_on_the_environment(p_B):
    tau_l = joint_torques(GEOMETRY, p_B, energy_gradient(p_B))
    F_ee_B = environment_force(GEOMETRY, MASSES, joint_angles(GEOMETRY, p_B), p_B, tau_l)
    np.testing.assert_allclose(F_ee_B, 0.0, rtol=0, atol=1e-6)  # as above


def test_unpowered_robot_presses_with_2_20_newton_at_home():
    F_ee_B = environment_force(GEOMETRY, MASSES, joint_angles(GEOMETRY, HOME), HOME, (0.0, 0.0, 0.0))
    # the reference value is given to 0.01 N; x and y vanish by symmetry
    np.testing.assert_allclose(F_ee_B, (0.0, 0.0, -2.20), rtol=0, atol=0.005)


def test_a_horizontal_arm_weighs_most_and_a_hanging_one_nothing():
    horizontal = arm_gravity_torque(GEOMETRY, MASSES, 0.0)
    # half the rod's weight and half the rod pair's, 35 g, at l_a = 60 mm; rounding only
    assert horizontal == pytest.approx(0.035 * 9.81 * 0.060, rel=1e-15)
    assert arm_gravity_torque(GEOMETRY, MASSES, np.pi / 2.0) == pytest.approx(0.0, abs=1e-17)


def test_leg_inertia_is_that_of_rods_about_their_end_plus_the_pulley():
    s = np.linspace(0.0, GEOMETRY.l_a, 10_001)
    # of the rod pair the share that the knee's own motion has: it falls from the knee to the platform
    rods = np.trapezoid((MASSES.m_a + MASSES.m_b) / GEOMETRY.l_a * s**2, s)
    # 1e-8: trapezoidal rule with 10,000 intervals
    assert leg_inertia(GEOMETRY, MASSES) == pytest.approx(rods + MASSES.I_r, rel=1e-8)


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_half_of_each_rod_pair_hangs_at_the_platform_and_a_third_of_it_resists_there(m_p, m_b):
    masses = MASSES._replace(m_p=m_p, m_b=m_b)
    assert platform_weight(masses) == (m_p + 3.0 * m_b / 2.0) * 9.81
    assert moving_mass(masses) == m_p + m_b
