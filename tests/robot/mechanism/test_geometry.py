import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.robot.mechanism.poses import GEOMETRY, working_poses
from twin.robot.mechanism.geometry import LEG_COS, LEG_SIN, distal_link, leg_coordinates


def turned(phi, vector):
    """A vector of the leg at azimuth phi, (outward, sideways, up), in the base frame."""
    c, s = math.cos(phi), math.sin(phi)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2]])


def test_legs_stand_at_minus_90_30_and_150_degrees():
    # 1e-15: cos and sin of a rounded angle
    np.testing.assert_allclose(LEG_COS, np.cos(np.radians([-90, 30, 150])), rtol=0, atol=1e-15)
    np.testing.assert_allclose(LEG_SIN, np.sin(np.radians([-90, 30, 150])), rtol=0, atol=1e-15)


def test_leg_directions_sum_to_zero_exactly():
    assert sum(LEG_COS) == 0.0
    assert sum(LEG_SIN) == 0.0


@given(working_poses, st.floats(-1.5, 3.0), st.sampled_from([0, 1, 2]))
def test_vector_loop_closes_over_every_leg(p_B, theta, leg):
    g = GEOMETRY
    phi = math.radians(-90 + 120 * leg)
    B = turned(phi, (g.a, 0, 0))
    BA = turned(phi, (g.l_a * math.cos(theta), 0, -g.l_a * math.sin(theta)))
    AP = distal_link(g, leg, math.cos(theta), math.sin(theta), *p_B)
    P = turned(phi, (g.b, 0, 0))
    # 1e-16 m: rounding of a few sums of lengths around 0.1 m
    np.testing.assert_allclose(B + BA + AP, p_B + P, rtol=0, atol=1e-16)


@given(working_poses, st.sampled_from([0, 1, 2]))
def test_leg_coordinates_are_the_platform_joint_seen_from_the_base_joint(p_B, leg):
    g = GEOMETRY
    phi = math.radians(-90 + 120 * leg)
    seen = turned(-phi, p_B + turned(phi, (g.b, 0, 0)) - turned(phi, (g.a, 0, 0)))
    # 1e-16 m: rounding of a few sums of lengths around 0.1 m
    np.testing.assert_allclose(leg_coordinates(g, leg, p_B[0], p_B[1]), seen[:2], rtol=0, atol=1e-16)
