import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.robot.mechanism.poses import GEOMETRY, TURN, geometries, reachable_poses, working_poses
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import (
    circumcentre,
    jacobian_rows,
    joint_angles,
    platform_position,
    position,
    sphere_centre,
    transmission_sines,
)
from twin.robot.mechanism.unreachable import Unreachable

outward_arm = st.floats(-0.6, 1.2)


@given(working_poses)
def test_forward_undoes_inverse_kinematics_in_the_working_range(p_B):
    # 1e-15 m: a few roundings of lengths around 0.1 m
    np.testing.assert_allclose(position(GEOMETRY, joint_angles(GEOMETRY, p_B)), p_B, rtol=0, atol=1e-15)


@given(reachable_poses())
def test_forward_undoes_inverse_kinematics_in_the_whole_workspace(p_B):
    # 2e-13 m: the same roundings, amplified where the distal links come near one plane
    np.testing.assert_allclose(position(GEOMETRY, joint_angles(GEOMETRY, p_B)), p_B, rtol=0, atol=2e-13)


def test_forward_undoes_inverse_kinematics_over_two_thousand_poses():
    p_B = np.random.default_rng(0).uniform([-0.03, -0.03, -0.13], [0.03, 0.03, -0.085], (2000, 3))
    # 2e-13 m: the accuracy this form was chosen for
    assert np.abs(position(GEOMETRY, joint_angles(GEOMETRY, p_B)) - p_B).max() < 2e-13


@given(geometries(), st.tuples(outward_arm, outward_arm, outward_arm))
def test_one_of_the_two_knees_undoes_forward_kinematics_for_any_robot(geometry, theta_l):
    p_B = position(geometry, theta_l)
    sines = transmission_sines(geometry, jacobian_rows(geometry, np.array([theta_l]), p_B[None]))
    assume(p_B[2] < 0.0 and sines.min() > 1e-3)
    knees = np.stack([joint_angles(geometry, p_B, branch) for branch in ("outward", "inward")])
    # 1e-11: rounding, amplified by up to 1e3 in the angle and in the root of D
    assert np.abs(knees - theta_l).min(axis=0).max() < 1e-11


@given(geometries(), outward_arm)
def test_equal_angles_put_the_platform_on_the_axis(geometry, theta):
    reach = geometry.a - geometry.b + geometry.l_a * math.cos(theta)
    z = -geometry.l_a * math.sin(theta) - math.sqrt(geometry.l_b**2 - reach**2)
    # 1e-14 m: rounding of lengths up to 1 m
    np.testing.assert_allclose(position(geometry, [theta] * 3), [0.0, 0.0, z], rtol=0, atol=1e-14)


@given(reachable_poses())
def test_turning_the_angles_by_one_leg_turns_the_platform_by_120_degrees(p_B):
    theta_l = joint_angles(GEOMETRY, p_B)
    # 2e-13 m: as the round trip over the whole workspace
    np.testing.assert_allclose(
        position(GEOMETRY, np.roll(theta_l, 1)), TURN @ position(GEOMETRY, theta_l), rtol=0, atol=2e-13
    )


@given(working_poses)
def test_the_other_intersection_is_the_platform_mirrored_through_the_plane_of_the_centres(p_B):
    theta_l = joint_angles(GEOMETRY, p_B)
    x, y, z, _, *normal = circumcentre(GEOMETRY, *theta_l)
    mirrored = p_B - 2.0 * np.dot(p_B - [x, y, z], normal) * np.array(normal)
    assert mirrored[2] > p_B[2]
    for leg, theta in enumerate(theta_l):
        centre = sphere_centre(GEOMETRY, leg, theta)
        # 1e-15 m: rounding of lengths around 0.1 m
        assert np.linalg.norm(mirrored - centre) == pytest.approx(GEOMETRY.l_b, abs=1e-15)


def test_the_platform_stays_on_its_side_when_the_triangle_of_centres_turns_over():
    # high and far out one arm points inward and the normal points down; no parallel singularity lies between
    p_B = (-0.0763, 0.0070, -0.0020)
    theta_l = joint_angles(GEOMETRY, p_B)
    assert circumcentre(GEOMETRY, *theta_l)[6] < 0.0
    # 2e-13 m: as the round trip over the whole workspace
    np.testing.assert_allclose(position(GEOMETRY, theta_l), p_B, rtol=0, atol=2e-13)


def test_a_batch_equals_its_single_poses():
    theta_l = np.random.default_rng(2).uniform(0.0, 0.8, (4, 5, 3))
    batch = position(GEOMETRY, theta_l)
    np.testing.assert_array_equal(batch, [[position(GEOMETRY, t) for t in row] for row in theta_l])


SHORT = GEOMETRY._replace(l_b=0.070)


def test_spheres_that_do_not_meet_have_no_position():
    assert np.isnan(platform_position(SHORT, 0.0, 0.0, 0.0)).all()


def test_refusal_names_the_length_at_which_the_distal_links_would_meet():
    # at theta = 0 the centres lie a - b + l_a = 80 mm from the axis
    with pytest.raises(Unreachable, match=r"would need l_b = 80\.0 mm to meet, have 70\.0 mm") as refused:
        position(SHORT, (0.0, 0.0, 0.0))
    assert refused.value.leg == 0
    # 1e-15 m: rounding of lengths around 0.1 m
    assert refused.value.excess == pytest.approx(0.010, abs=1e-15)


def test_refusal_names_the_first_offender_of_a_batch_and_its_index():
    theta_l = np.full((3, 3), 1.2)
    theta_l[1] = 0.1
    theta_l[2] = 0.0
    with pytest.raises(Unreachable, match=r"theta_l\[1\] = \(5\.73, 5\.73, 5\.73\) deg"):
        position(SHORT, theta_l)


@given(st.tuples(*[st.floats(-3.0, 3.0)] * 3))
def test_distal_links_longer_by_the_excess_just_meet(theta_l):
    try:
        position(SHORT, theta_l)
        return
    except Unreachable as refused:
        excess = refused.excess
    assume(excess < 10.0)
    # relative 1e-9 on either side of the edge, far above rounding
    position(SHORT._replace(l_b=SHORT.l_b + excess * (1 + 1e-9)), theta_l)
    with pytest.raises(Unreachable):
        position(SHORT._replace(l_b=SHORT.l_b + excess * (1 - 1e-9)), theta_l)


def test_centres_on_one_line_are_refused():
    # a - b + l_a = 0 in exact binary fractions: with horizontal arms all three centres are the same point
    geometry = Geometry(a=0.0625, b=0.125, l_a=0.0625, l_b=0.125)
    with pytest.raises(Unreachable):
        position(geometry, (0.0, 0.0, 0.0))
