import math

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.robot.mechanism.poses import GEOMETRY, HOME, TURN, geometries, reachable_poses, working_poses
from twin.kernel.errors import InputRefused
from twin.robot.mechanism.geometry import Geometry, distal_link, leg_coordinates
from twin.robot.mechanism.kinematics import (
    distal_length_range,
    joint_angles,
    leg_angle,
    leg_angle_inward,
    loop_coefficients,
)
from twin.robot.mechanism.unreachable import Unreachable

branches = st.sampled_from(["outward", "inward"])


def distal_lengths(geometry, theta_l, p_B):
    return [
        np.linalg.norm(distal_link(geometry, leg, math.cos(theta), math.sin(theta), *p_B))
        for leg, theta in enumerate(theta_l)
    ]


def test_home_pose_is_at_19_99_degrees_on_every_leg():
    # the reference value is given to 0.01 deg
    np.testing.assert_allclose(np.degrees(joint_angles(GEOMETRY, HOME)), 19.99, rtol=0, atol=0.005)


@given(reachable_poses(), branches)
def test_joint_angles_give_every_distal_link_its_length(p_B, branch):
    # 1e-14 m: near the edge of the workspace the root of D loses half its digits and so does the angle, but
    # the length hardly depends on the angle there
    np.testing.assert_allclose(
        distal_lengths(GEOMETRY, joint_angles(GEOMETRY, p_B, branch), p_B), GEOMETRY.l_b, rtol=0, atol=1e-14
    )


@given(reachable_poses(), st.sampled_from([0, 1, 2]), st.floats(-4.0, 4.0))
def test_loop_coefficients_are_the_squared_length_error_at_any_angle(p_B, leg, theta):
    E, F, G = loop_coefficients(GEOMETRY, leg, *p_B)
    link = np.array(distal_link(GEOMETRY, leg, math.cos(theta), math.sin(theta), *p_B))
    # 1e-16 m2: rounding of sums of squares around 0.05 m2
    error = np.dot(link, link) - GEOMETRY.l_b**2
    assert E * math.cos(theta) + F * math.sin(theta) + G == pytest.approx(error, abs=1e-16)


@given(reachable_poses(), st.sampled_from([0, 1, 2]))
def test_the_two_knees_mirror_each_other_in_the_line_from_base_to_platform_joint(p_B, leg):
    u, _ = leg_coordinates(GEOMETRY, leg, p_B[0], p_B[1])
    line = math.atan2(-p_B[2], u)
    outward, inward = leg_angle(GEOMETRY, leg, *p_B), leg_angle_inward(GEOMETRY, leg, *p_B)
    assert outward < line < inward
    # 1e-12: both angles share the error of sqrt(D), which cancels in the sum
    assert outward + inward == pytest.approx(2.0 * line, abs=1e-12)


@given(reachable_poses())
def test_each_branch_has_its_knees_on_all_legs(p_B):
    outward, inward = ([angle(GEOMETRY, leg, *p_B) for leg in range(3)] for angle in (leg_angle, leg_angle_inward))
    np.testing.assert_array_equal(joint_angles(GEOMETRY, p_B, "outward"), outward)
    np.testing.assert_array_equal(joint_angles(GEOMETRY, p_B, "inward"), inward)


@given(working_poses, branches)
def test_turning_the_platform_by_120_degrees_passes_the_angles_to_the_next_leg(p_B, branch):
    # 1e-13 rad: the turned pose is rounded to 1e-17 m, times |J| = 20 rad/m, times the angle's conditioning
    turned = joint_angles(GEOMETRY, TURN @ p_B, branch)
    np.testing.assert_allclose(turned, np.roll(joint_angles(GEOMETRY, p_B, branch), 1), rtol=0, atol=1e-13)


@given(working_poses)
def test_mirroring_the_pose_in_x_swaps_legs_two_and_three(p_B):
    mirrored = joint_angles(GEOMETRY, p_B * [-1, 1, 1])
    # exact: the two legs see the same numbers, once with the sign of w changed
    np.testing.assert_array_equal(mirrored, joint_angles(GEOMETRY, p_B)[[0, 2, 1]])


@given(working_poses, st.floats(0.01, 100.0))
def test_angles_do_not_depend_on_the_unit_of_length(p_B, scale):
    scaled = Geometry(*(scale * length for length in GEOMETRY))
    # 1e-13: rounding of the scaled lengths through the same formula
    np.testing.assert_allclose(joint_angles(scaled, scale * p_B), joint_angles(GEOMETRY, p_B), rtol=0, atol=1e-13)


@given(working_poses, st.sampled_from([0, 1, 2]))
def test_outward_angle_is_the_root_found_with_fifty_digits(p_B, leg):
    with mpmath.workdps(50):
        E, F, G = (mpmath.mpf(float(value)) for value in loop_coefficients(GEOMETRY, leg, *p_B))
        root = 2 * mpmath.atan2(G + E, mpmath.sqrt(E**2 + F**2 - G**2) - F)
    # 5e-15 rad: a handful of roundings of numbers of order one, no cancellation
    assert leg_angle(GEOMETRY, leg, *p_B) == pytest.approx(float(root), abs=5e-15)


def test_a_batch_equals_its_single_poses():
    p_B = np.random.default_rng(1).uniform([-0.03, -0.03, -0.13], [0.03, 0.03, -0.085], (4, 5, 3))
    batch = joint_angles(GEOMETRY, p_B)
    single = [[joint_angles(GEOMETRY, p) for p in row] for row in p_B]
    np.testing.assert_array_equal(batch, single)


@pytest.mark.parametrize("leg", range(3))
def test_the_range_of_distal_links_of_a_batch_is_that_of_its_single_poses(leg):
    poses = np.random.default_rng(0).uniform((-0.02, -0.02, -0.11), (0.02, 0.02, -0.09), size=(2, 4, 3))
    single = [[distal_length_range(GEOMETRY, leg, pose) for pose in row] for row in poses]
    found = np.moveaxis(distal_length_range(GEOMETRY, leg, poses), 0, -1)
    np.testing.assert_array_equal(found, single)


def test_an_empty_batch_stays_empty():
    assert joint_angles(GEOMETRY, np.empty((0, 3))).shape == (0, 3)


def test_a_leg_out_of_reach_is_not_a_number():
    assert math.isnan(leg_angle(GEOMETRY, 0, 0.0, 0.0, -0.2))
    assert math.isnan(leg_angle_inward(GEOMETRY, 0, 0.0, 0.0, -0.2))


def test_refusal_names_leg_pose_and_missing_length():
    with pytest.raises(Unreachable) as refused:
        joint_angles(GEOMETRY, (0.0, 0.0, -0.180))
    # leg 1: sqrt(20^2 + 180^2) - 60 = 121.1 mm from the farthest point A_1 reaches
    assert "leg 1 would need l_b = 121.1 mm, has 113.9 mm" in str(refused.value)
    assert "(0.0, 0.0, -180.0) mm" in str(refused.value)
    assert refused.value.leg == 1
    assert refused.value.pose == (0.0, 0.0, -0.180)


def test_refusal_names_the_first_offender_of_a_batch_and_its_index():
    p_B = np.full((2, 3, 3), HOME)
    p_B[1, 0] = (0.0, 0.09, -0.160)
    p_B[1, 2] = (0.0, 0.0, -0.200)
    with pytest.raises(Unreachable, match=r"p_B\[1, 0\] = \(0\.0, 90\.0, -160\.0\) mm") as refused:
        joint_angles(GEOMETRY, p_B)
    assert refused.value.leg == 1


far_or_close = st.tuples(st.floats(-0.2, 0.2), st.floats(-0.2, 0.2), st.floats(-0.3, -1e-3))


@given(geometries(), far_or_close)
def test_a_distal_link_changed_by_the_excess_just_reaches(geometry, p_B):
    try:
        joint_angles(geometry, p_B)
        return
    except Unreachable as refused:
        leg, excess = refused.leg - 1, refused.excess
    assert excess > 0.0

    def reaches(change):
        longer_and_shorter = (geometry.l_b + change, geometry.l_b - change)
        return any(
            not math.isnan(leg_angle(geometry._replace(l_b=l_b), leg, *p_B)) for l_b in longer_and_shorter if l_b > 0.0
        )

    # 1e-9 m on either side of the edge, far above rounding of lengths below 1 m
    assert reaches(excess + 1e-9)
    assert excess < 1e-9 or not reaches(excess - 1e-9)


@pytest.mark.parametrize("p_B", [0.1, (0.0, 0.0), np.zeros((3, 2))])
def test_a_pose_of_wrong_shape_is_refused(p_B):
    with pytest.raises(InputRefused, match=r"p_B has shape .*; expected \(\.\.\., 3\)"):
        joint_angles(GEOMETRY, p_B)


def test_a_pose_that_is_not_finite_is_refused_with_its_own_index_and_numbers():
    with pytest.raises(InputRefused, match=r"p_B\[1\] = \[ +nan +0\.01 +-0\.2 *\] is not finite"):
        joint_angles(GEOMETRY, [[0.0, 0.0, -0.1], [np.nan, 0.01, -0.2], [0.0, 0.0, -0.1]])


def test_a_branch_that_does_not_exist_is_refused_with_the_two_that_do():
    with pytest.raises(InputRefused, match="branch is 'upward'; expected 'outward' or 'inward'"):
        joint_angles(GEOMETRY, HOME, "upward")  # type: ignore[arg-type]
