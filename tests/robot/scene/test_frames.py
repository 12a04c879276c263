"""The frames close the chain wherever the robot works."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.robot.mechanism.poses import GEOMETRY, HOME, triple, working_poses
from tests.robot.scene.pictures import at
from twin.kernel.errors import InputRefused
from twin.robot.mechanism.geometry import AXIS, OUTWARD
from twin.robot.mechanism.kinematics import joint_angles
from twin.robot.scene.frames import FRAMES, HALF_WIDTH, IDENTITY, pointing, poses, product, turn

# rounding of a dozen operations on numbers up to 1
ROUNDING = 1e-14
angles = st.floats(-math.pi, math.pi)
axes = st.sampled_from([0, 1, 2])


@given(axes, angles)
def test_a_turn_is_right_handed_about_its_axis(axis, angle):
    expected = Rotation.from_euler("xyz"[axis], angle).as_matrix()
    np.testing.assert_allclose(Rotation.from_quat(turn(axis, angle)).as_matrix(), expected, atol=ROUNDING)


@given(axes, angles, axes, angles)
def test_a_product_turns_by_its_second_factor_first(axis, angle, other_axis, other_angle):
    p, q = turn(axis, angle), turn(other_axis, other_angle)
    expected = Rotation.from_quat(p) * Rotation.from_quat(q)
    found = Rotation.from_quat(product(p, q))
    np.testing.assert_allclose(found.as_matrix(), expected.as_matrix(), atol=ROUNDING)


@given(triple.filter(lambda v: np.linalg.norm(v) > 0))
def test_a_pointing_turn_takes_e_x_to_the_direction_of_its_vector(v):
    found = Rotation.from_quat(pointing(*v)).apply([1.0, 0.0, 0.0])
    np.testing.assert_allclose(found, v / np.linalg.norm(v), atol=ROUNDING)


def test_nothing_points_nowhere_without_a_turn():
    assert np.array_equal(pointing(0.0, 0.0, 0.0), IDENTITY)


# rounding of a dozen operations on lengths of 0.1 m
SURFACE = np.array([0.0, 0.0, -0.1, 0.0, 0.0, 0.0, 1.0])


def frames_at(p_B):
    """Frame -> pose (1, 7) with the platform at p_B."""
    found = poses(GEOMETRY, joint_angles(GEOMETRY, p_B)[None], p_B[None], SURFACE[None])
    return {frame: found[:, i] for i, frame in enumerate(FRAMES)}


@given(working_poses)
def test_links_carry_the_rods_and_the_rods_end_at_the_platform_joints(p_B):
    frames = frames_at(p_B)
    for leg in range(3):
        for side, aside in (("minus", -HALF_WIDTH), ("plus", HALF_WIDTH)):
            link, rod = frames[f"link_{leg + 1}"], frames[f"rod_{leg + 1}_{side}"]
            end_of_link = at(link, (GEOMETRY.l_a, aside, 0.0))
            np.testing.assert_allclose(at(rod, (0.0, 0.0, 0.0)), end_of_link, atol=ROUNDING)
            joint = p_B + GEOMETRY.b * OUTWARD[leg] + aside * AXIS[leg]
            np.testing.assert_allclose(at(rod, (GEOMETRY.l_b, 0.0, 0.0)), joint[None], atol=ROUNDING)


@given(working_poses)
def test_a_link_turns_about_the_axis_of_its_joint(p_B):
    frames = frames_at(p_B)
    for leg in range(3):
        link = frames[f"link_{leg + 1}"]
        np.testing.assert_allclose(at(link, (0.0, 1.0, 0.0)) - link[:, :3], AXIS[leg][None], atol=ROUNDING)
        np.testing.assert_allclose(link[0, :3], GEOMETRY.a * OUTWARD[leg], atol=ROUNDING)


def test_at_home_every_rod_hangs_in_the_plane_of_its_leg():
    frames = frames_at(np.array(HOME))
    for leg in range(3):
        rod = frames[f"rod_{leg + 1}_plus"]
        # the rod's own y axis is the joint's as long as it does not swing sideways
        np.testing.assert_allclose(at(rod, (0.0, 1.0, 0.0)) - rod[:, :3], AXIS[leg][None], atol=ROUNDING)


def test_a_pose_that_is_no_number_is_refused():
    with pytest.raises(InputRefused, match="p_B"):
        poses(GEOMETRY, np.zeros((1, 3)), np.full((1, 3), np.nan), SURFACE[None])
