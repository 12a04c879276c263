"""How far ball joints bend and bars stay apart, against bars looked at point by point."""

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import examples
from tests.laws.runs import PARAMETERS
from twin.robot.mechanism.geometry import AXIS, Geometry, skeleton
from twin.robot.mechanism.kinematics import joint_angles
from twin.robot.mechanism.workspace import BARS_PER_LEG, Bars, ball_joint_angles, clearances, segment_distance

GEOMETRY = Geometry(*PARAMETERS[:4])
BAR = Bars(0.009, 0.004, 0.024)
HOME = np.array([[0.0, 0.0, -0.105]])
poses = st.tuples(*[st.floats(-0.04, 0.04)] * 2, st.floats(-0.12, -0.075)).map(lambda p: np.array([p]))


@given(poses)
def test_a_ball_joint_bends_by_what_its_rod_is_off_a_right_angle_to_the_axis_of_the_joint(p_B):
    joints = skeleton(GEOMETRY, joint_angles(GEOMETRY, p_B), p_B)
    along = np.einsum("ij,ij->i", (joints.P - joints.A)[0], AXIS) / GEOMETRY.l_b
    np.testing.assert_allclose(ball_joint_angles(GEOMETRY, p_B)[0], np.abs(np.arcsin(along)), rtol=0, atol=1e-12)


def test_at_home_no_ball_joint_is_bent_and_the_legs_are_as_far_apart_as_their_platform_joints():
    assert np.array_equal(ball_joint_angles(GEOMETRY, HOME), [[0.0, 0.0, 0.0]])
    gaps, pairs = clearances(GEOMETRY, BAR, HOME)
    # neighbouring ends of rods at the platform: corners of a hexagon of two sides
    corners = [GEOMETRY.b * np.array([np.cos(a), np.sin(a), 0.0]) for a in np.radians([-90.0, 30.0])]
    apart = (corners[0] + BAR.rod_spacing / 2.0 * AXIS[0]) - (corners[1] - BAR.rod_spacing / 2.0 * AXIS[1])
    assert abs(gaps[0] - (np.linalg.norm(apart) - BAR.rod_diameter)) < 1e-12
    assert all(bar % BARS_PER_LEG for bar in pairs[0])


@given(st.lists(st.tuples(*[st.integers(-9, 9).map(float)] * 3), min_size=4, max_size=4, unique=True))
def test_two_segments_are_as_far_apart_as_their_nearest_points(ends):
    a, b, c, d = (np.array(end) for end in ends)
    apart = segment_distance(a, b, c, d)
    assert apart == pytest.approx(segment_distance(d, c, b, a), abs=1e-9)
    share = np.linspace(0.0, 1.0, 101)[:, None]
    one, other = a + share * (b - a), c + share * (d - c)
    seen = np.linalg.norm(one[:, None] - other[None], axis=-1).min()
    # points 0.01 of a length of at most 32 apart, half of that off on either
    assert apart - 1e-9 <= seen <= apart + 0.32


@examples(15)
@given(poses, st.floats(0.01, 0.08))
def test_the_gap_is_that_of_the_nearest_points_of_any_two_bars_of_different_legs(p_B, spacing):
    bars = BAR._replace(rod_spacing=spacing)
    joints = skeleton(GEOMETRY, joint_angles(GEOMETRY, p_B), p_B)
    share = np.linspace(0.0, 1.0, 61)[:, None]
    points, radii = [], []
    for leg in range(3):
        for kind, way in ((0, 0.0), (1, -0.5), (2, 0.5)):
            ends = (joints.B[leg], joints.A[0, leg]) if kind == 0 else (joints.A[0, leg], joints.P[0, leg])
            start, end = (end + way * spacing * AXIS[leg] for end in ends)
            points.append(start + share * (end - start))
            radii.append((bars.rod_diameter if kind else bars.link_diameter) / 2.0)
    seen = min(
        np.linalg.norm(points[i][:, None] - points[j][None], axis=-1).min() - radii[i] - radii[j]
        for i, j in product(range(9), repeat=2)
        if i // BARS_PER_LEG < j // BARS_PER_LEG
    )
    gap = clearances(GEOMETRY, bars, p_B)[0][0]
    # points 2 mm apart along a bar: half of that at most on either
    assert gap - 1e-12 <= seen <= gap + 2e-3
