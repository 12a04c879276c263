"""The drawn robot is the robot: its links have their lengths and meet."""

import numpy as np
from hypothesis import given

from tests.robot.mechanism.poses import GEOMETRY, working_poses
from twin.robot.mechanism.geometry import AXIS, OUTWARD, skeleton
from twin.robot.mechanism.kinematics import joint_angles

# rounding of a few operations on lengths of 0.1 m
ROUNDING = 1e-15


@given(working_poses)
def test_links_have_their_lengths_wherever_the_robot_works(p_B):
    B, A, P = skeleton(GEOMETRY, joint_angles(GEOMETRY, p_B)[None], p_B[None])
    np.testing.assert_allclose(np.linalg.norm(A - B, axis=-1), GEOMETRY.l_a, atol=ROUNDING)
    np.testing.assert_allclose(np.linalg.norm(P - A, axis=-1), GEOMETRY.l_b, atol=1e2 * ROUNDING)


def test_a_positive_angle_lowers_the_link_as_a_right_handed_turn_about_its_axis():
    theta_l = np.full((1, 3), 0.3)
    B, A, _ = skeleton(GEOMETRY, theta_l, np.array([[0.0, 0.0, -0.1]]))
    turned = GEOMETRY.l_a * (np.cos(0.3) * OUTWARD + np.sin(0.3) * np.cross(AXIS, OUTWARD))
    np.testing.assert_allclose(A[0] - B, turned, atol=ROUNDING)
    assert np.all(A[0, :, 2] < 0.0)
