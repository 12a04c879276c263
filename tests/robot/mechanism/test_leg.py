"""The leg without trigonometry against the plain forms: Eq. 10 to 12, cosine, sine and the Jacobian's own rows."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.robot.mechanism.poses import GEOMETRY, geometries, reachable_poses, triple, working_poses
from twin.kernel.compiled.function import njit
from twin.robot.mechanism import geometry as base
from twin.robot.mechanism.geometry import (
    LEG_COS,
    LEG_SIN,
    MAX_SERIES_SINE,
    NO_ANCHOR,
    angle_near,
    angles_near,
    coordinates_along,
    distal_link,
    leg_coordinates,
    leg_motion,
    leg_vectors,
    links,
    move_anchor,
)
from twin.robot.mechanism.kinematics import jacobian, jacobian_row, joint_angles, leg_angle

legs = st.integers(0, 2)


def in_leg(leg, v):
    """(outward, sideways, up) of a vector of base frame B."""
    C, S = LEG_COS[leg], LEG_SIN[leg]
    return C * v[0] + S * v[1], C * v[1] - S * v[0], v[2]


def motion(leg, p_B, v):
    return leg_motion(GEOMETRY, *leg_vectors(GEOMETRY, leg, *p_B), *in_leg(leg, v))


@given(working_poses, legs)
def test_knee_and_distal_link_are_those_of_the_joint_angle(p_B, leg):
    k_r, k_z, r, w, h, _ = leg_vectors(GEOMETRY, leg, *p_B)
    theta = leg_angle(GEOMETRY, leg, *p_B)
    # 1e-13 of the lengths: rounding of two different formulas
    assert (k_r, -k_z) == pytest.approx(
        (GEOMETRY.l_a * math.cos(theta), GEOMETRY.l_a * math.sin(theta)), rel=0, abs=1e-13 * GEOMETRY.l_a
    )
    link = in_leg(leg, distal_link(GEOMETRY, leg, math.cos(theta), math.sin(theta), *p_B))
    assert (r, w, h) == pytest.approx(link, rel=0, abs=1e-13 * GEOMETRY.l_b)


@given(geometries(), st.floats(-0.5, 0.5), st.floats(-0.5, 0.5), st.floats(0.2, 0.95), legs)
def test_links_have_their_lengths_and_the_knee_is_outward_on_any_robot(geometry, across, along, share, leg):
    reach = geometry.l_a + geometry.l_b
    p_B = across * geometry.a, along * geometry.a, -share * reach
    u, _ = leg_coordinates(geometry, leg, p_B[0], p_B[1])
    k_r, k_z, r, w, h, q = leg_vectors(geometry, leg, *p_B)
    if math.isnan(q):
        assert math.isnan(leg_angle(geometry, leg, *p_B))
        return
    # 1e-13 relative: rounding
    assert math.hypot(k_r, k_z) == pytest.approx(geometry.l_a, rel=1e-13)
    assert math.sqrt(r * r + w * w + h * h) == pytest.approx(geometry.l_b, rel=1e-13)
    # on the outer side of the line from B_i to P_i, as Eq. 10's root with the knee outward; q is twice the triangle
    assert u * k_z - p_B[2] * k_r == pytest.approx(geometry.l_a * q, rel=1e-9, abs=1e-15)
    assert q >= 0.0


@given(working_poses, legs, triple)
def test_row_and_speed_are_those_of_the_jacobian(p_B, leg, v):
    j_r, j_w, j_z, omega_l, _ = motion(leg, p_B, v)
    row = jacobian_row(GEOMETRY, leg, leg_angle(GEOMETRY, leg, *p_B), *p_B)
    # 1e-13 of the largest row of these poses, 30 rad/m; both divide by what is small near the edge
    assert (j_r, j_w, j_z) == pytest.approx(in_leg(leg, row), rel=1e-13, abs=1e-13 * 30.0)
    assert omega_l == pytest.approx(np.dot(row, v), rel=1e-13, abs=1e-13 * 30.0)


@given(working_poses, legs, triple)
def test_kappa_is_the_rate_of_the_joint_speed_at_constant_velocity(p_B, leg, v):
    step = 1e-30
    thetadot = jacobian(GEOMETRY, p_B) @ v
    theta_l = joint_angles(GEOMETRY, p_B)
    x, y, z = p_B + 1j * step * v
    row = jacobian_row(GEOMETRY, leg, theta_l[leg] + 1j * step * thetadot[leg], x, y, z)
    # 1e-13 relative to 1e3 rad/s2 at 1 m/s, with room for the conditioning near the upper edge
    assert motion(leg, p_B, v)[4] == pytest.approx(np.dot(row, v).imag / step, rel=1e-11, abs=1e-9)


@given(working_poses, legs, st.floats(0.01, 100.0))
def test_kappa_grows_with_the_square_of_speed(p_B, leg, factor):
    v = np.array([0.1, 0.2, 0.3])
    once, scaled = motion(leg, p_B, v)[4], motion(leg, p_B, factor * v)[4]
    # 1e-9: rounding of two terms that partly cancel
    assert scaled == pytest.approx(once * factor**2, rel=1e-9, abs=1e-9 * factor**2)


@given(reachable_poses(), legs, triple, st.floats(0.0, 3.0 * MAX_SERIES_SINE))
def test_an_angle_is_the_same_from_any_anchor(p_B, leg, way, far):
    anchors = NO_ANCHOR.copy()
    # of a pose so far away that the joint turns by up to three times what a series is taken for
    row = jacobian(GEOMETRY, p_B)[leg]
    k_r, k_z, *_, q = leg_vectors(GEOMETRY, leg, *(p_B + far / max(np.linalg.norm(row), 1.0) * way))
    if math.isnan(q):
        return
    move_anchor(GEOMETRY, anchors, leg, k_r, k_z)
    k_r, k_z, *_ = leg_vectors(GEOMETRY, leg, *p_B)
    # rounding of the pose's own knee is in both
    expected = math.atan2(-k_z, k_r)
    assert angle_near(anchors, leg, k_r, k_z) == pytest.approx(expected, rel=0, abs=1e-15)
    # near the fold the knee itself is known to the root of the rounding
    assert expected == pytest.approx(leg_angle(GEOMETRY, leg, *p_B), rel=0, abs=1e-12 + 1e-17 / max(q, 1e-17))


@given(working_poses, legs)
def test_an_anchor_stays_while_it_is_near_and_moves_when_it_is_not(p_B, leg):
    anchors = NO_ANCHOR.copy()
    k_r, k_z, *_ = leg_vectors(GEOMETRY, leg, *p_B)
    move_anchor(GEOMETRY, anchors, leg, k_r, k_z)
    before = anchors.copy()

    def turned(angle):
        return k_r * math.cos(angle) + k_z * math.sin(angle), k_z * math.cos(angle) - k_r * math.sin(angle)

    move_anchor(GEOMETRY, anchors, leg, *turned(0.4 * MAX_SERIES_SINE))
    np.testing.assert_array_equal(anchors, before)
    move_anchor(GEOMETRY, anchors, leg, *turned(0.6 * MAX_SERIES_SINE))
    # rounding
    assert anchors[leg, 0] == pytest.approx(before[leg, 0] + 0.6 * MAX_SERIES_SINE, rel=0, abs=1e-15)


def test_out_of_reach_there_is_no_knee_and_no_exception():
    assert all(math.isnan(value) for value in leg_vectors(GEOMETRY, 0, 0.0, 0.0, -0.5)[:3])
    # stretched: the row is infinite
    assert not math.isfinite(leg_motion(GEOMETRY, 0.06, 0.0, 0.1, 0.0, -0.05, 0.0, 0.1, 0.0, 0.0)[0])


@njit(cache=False, error_model="numpy")
def at_once(geometry, anchors, x, y, z, v_x, v_y, v_z):
    C, S = base.legs()
    u, w = coordinates_along(geometry, C, S, x, y)
    k_r, k_z, r, w, h, q = links(geometry, u, w, z)
    theta_l = angles_near(anchors, k_r, k_z)
    j_r, j_w, j_z, omega_l, kappa = leg_motion(
        geometry, k_r, k_z, r, w, h, q, C * v_x + S * v_y, C * v_y - S * v_x, v_z
    )
    found = np.empty((3, 12))
    for leg in range(3):
        found[leg, 0], found[leg, 1], found[leg, 2], found[leg, 3] = k_r[leg], k_z[leg], r[leg], w[leg]
        found[leg, 4], found[leg, 5], found[leg, 6], found[leg, 7] = h[leg], q[leg], j_r[leg], j_w[leg]
        found[leg, 8], found[leg, 9], found[leg, 10], found[leg, 11] = j_z[leg], omega_l[leg], kappa[leg], theta_l[leg]
    return found


@given(reachable_poses(), triple, triple, st.floats(0.0, 3.0 * MAX_SERIES_SINE))
def test_three_legs_at_once_are_each_leg_alone_to_the_last_bit(p_B, v, way, far):
    anchors = NO_ANCHOR.copy()
    for leg in range(3):
        # some near, some not, some of no pose at all
        k_r, k_z, *_ = leg_vectors(GEOMETRY, leg, *(p_B + far * way * leg))
        move_anchor(GEOMETRY, anchors, leg, k_r, k_z)
    found = at_once(GEOMETRY, anchors, *p_B, *v)
    for leg in range(3):
        vectors = leg_vectors(GEOMETRY, leg, *p_B)
        alone = *vectors, *motion(leg, p_B, v), angle_near(anchors, leg, *vectors[:2])
        np.testing.assert_array_equal(found[leg], alone)
