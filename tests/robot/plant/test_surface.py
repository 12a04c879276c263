"""A tilted base turns gravity, and nothing else; a head elsewhere touches elsewhere."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.laws.runs import PARAMETERS
from tests.robot.plant.states import moving, positions, share
from twin.robot.mechanism.geometry import Geometry, skeleton
from twin.robot.mechanism.kinematics import joint_angles
from twin.robot.mechanism.statics import G_ACCELERATION
from twin.robot.plant.component import NO_MOTION, rest_state
from twin.robot.plant.contact import Shape, contact_force, surface_frame
from twin.robot.plant.dynamics import derivative
from twin.robot.plant.joints import upward

GEOMETRY = Geometry(*PARAMETERS[:4])
tilts = st.floats(-np.pi, np.pi)
heads = st.tuples(*[st.floats(-0.01, 0.01)] * 3)


def turned(tilt: float, tilt_x: float) -> np.ndarray:
    """R_y(tilt) R_x(tilt_x): the base's axes in the room."""
    cos, sin = np.cos(tilt), np.sin(tilt)
    about_y = np.array([[cos, 0.0, sin], [0.0, 1.0, 0.0], [-sin, 0.0, cos]])
    cos, sin = np.cos(tilt_x), np.sin(tilt_x)
    return about_y @ np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])


@given(tilts, tilts)
def test_up_is_the_rooms_z_seen_from_the_base(tilt, tilt_x):
    parameters = PARAMETERS._replace(mounting_tilt=tilt, mounting_tilt_x=tilt_x)
    np.testing.assert_allclose(upward(parameters), turned(tilt, tilt_x).T @ [0.0, 0.0, 1.0], rtol=0, atol=1e-15)


def potential(parameters, p_B, up) -> float:
    """Of all weights (J): platform, rods and links by their centres in the tilted room, body by body."""
    found = skeleton(GEOMETRY, joint_angles(GEOMETRY, p_B)[None], np.array(p_B)[None])
    A, P, B = found.A[0], found.P[0], found.B
    links, rods = (A + B) / 2.0, (A + P) / 2.0
    height = parameters.m_p * np.array(p_B) + parameters.m_a * links.sum(axis=0) + parameters.m_b * rods.sum(axis=0)
    return float(G_ACCELERATION * height @ up)


@given(positions(lowest=-0.1), tilts, tilts)
def test_springs_at_rest_do_the_work_that_lifts_the_robot_in_a_tilted_room(p_B, tilt, tilt_x):
    parameters = PARAMETERS._replace(mounting_tilt=tilt, mounting_tilt_x=tilt_x, backlash=0.0)
    up = turned(tilt, tilt_x)[2]
    _, theta_m = rest_state(parameters, p_B)
    tau_l = parameters.k_s * parameters.N * (theta_m - parameters.N * joint_angles(GEOMETRY, p_B))
    step = 1e-6
    for axis in np.eye(3):
        ends = [p_B + step * axis, p_B - step * axis]
        lifted = potential(parameters, ends[0], up) - potential(parameters, ends[1], up)
        turn = joint_angles(GEOMETRY, ends[0]) - joint_angles(GEOMETRY, ends[1])
        # central differences of 1 um: 1e-10 of 4 N per m, and rounding of J over 1e-6 m
        assert tau_l @ turn == pytest.approx(lifted, rel=0, abs=1e-13)


@given(moving(), tilts)
def test_a_third_of_a_turn_of_tilt_and_pose_is_the_same_robot_with_other_legs(state, tilt):
    """Nothing prefers a leg: about the vertical the robot looks alike after 120 degrees."""
    x, theta_m = state
    base = PARAMETERS._replace(mounting_tilt=tilt, mu=0.0)
    third = turned_about_z(2.0 * np.pi / 3.0)
    up = third @ np.array(upward(base))
    # the angles whose up is that
    other = base._replace(mounting_tilt_x=np.arctan2(up[1], up[2]), mounting_tilt=np.arcsin(-up[0]))
    dx, dy = np.empty(8), np.empty(8)
    derivative(base, x, theta_m, NO_MOTION, NO_MOTION, dx)
    y = np.concatenate([third @ x[:3], third @ x[3:6], np.zeros(2)])
    derivative(other, y, np.roll(theta_m, 1), NO_MOTION, NO_MOTION, dy)
    # rounding of up to 100 m/s2
    np.testing.assert_allclose(dy[3:6], third @ dx[3:6], rtol=0, atol=1e-9)


def turned_about_z(angle: float) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


@given(moving(), heads, st.sampled_from([Shape.PLANE, Shape.SPHERE]))
def test_a_head_elsewhere_is_the_same_as_a_surface_as_far_the_other_way(state, head, shape):
    x, theta_m = state
    there = PARAMETERS._replace(shape=int(shape), radius=0.08, tilt=0.1)
    with_head = there._replace(head=head)

    def rates(parameters, s_B):
        dx = np.empty(8)
        derivative(parameters, x, theta_m, s_B, NO_MOTION, dx)
        return dx

    away = tuple(-value for value in head)
    # rounding, which 1250 N/m on 0.2 kg make larger
    np.testing.assert_allclose(rates(with_head, NO_MOTION), rates(there, away), rtol=0, atol=1e-8)


@given(positions(highest=-0.104), heads, st.tuples(*[st.floats(-0.3, 0.3)] * 3))
def test_contact_works_at_the_head_what_it_works_on_the_platform(p_B, head, v):
    """The platform does not turn: head and O_P have one velocity, so one Jacobian, and no torque does work."""
    parameters = PARAMETERS._replace(shape=int(Shape.SPHERE), radius=0.08, mu=0.0, head=head)
    force = np.array(contact_force(parameters, *p_B, 0.0, 0.0, 0.0, 0.0, 0.0))
    depth, _, _, n = surface_frame(parameters, *p_B)
    np.testing.assert_allclose(force, -parameters.K * max(depth, 0.0) * np.array(n), rtol=0, atol=1e-12)
    # what goes into the surface is what the depth grows by
    step = 1e-6
    deeper = (
        surface_frame(parameters, *(p_B + step * np.array(v)))[0]
        - surface_frame(parameters, *(p_B - step * np.array(v)))[0]
    )
    assert force @ np.array(v) == pytest.approx(parameters.K * max(depth, 0.0) * deeper / (2.0 * step), abs=1e-6)


shapes = st.sampled_from([int(shape) for shape in Shape])
curved_shapes = st.sampled_from([int(shape) for shape in Shape if shape != Shape.PLANE])
surface_tilts = st.integers(-60, 60).map(lambda degrees: np.radians(degrees))
APEX = np.array([0.0, 0.0, PARAMETERS.z_s])
places = st.tuples(share, share, share).map(lambda place: APEX + 0.02 * np.array(place))
velocities = st.tuples(share, share, share).map(np.array)
RADIUS = 0.05


def surface(shape: int, tilt=0.0, tilt_x=0.0, radius=RADIUS):
    return PARAMETERS._replace(shape=int(shape), tilt=tilt, tilt_x=tilt_x, radius=radius)


def depth(parameters, p_B):
    return surface_frame(parameters, *p_B)[0]


@given(shapes, surface_tilts, surface_tilts, places)
def test_depth_grows_against_the_normal(shape, tilt, tilt_x, p_B):
    parameters = surface(shape, tilt, tilt_x)
    step = 1e-6
    gradient = [(depth(parameters, p_B + e) - depth(parameters, p_B - e)) / (2.0 * step) for e in step * np.eye(3)]
    # central difference: rounding 1e-17 / 1e-6, curvature (step/R)^2
    np.testing.assert_allclose(gradient, -np.array(surface_frame(parameters, *p_B)[3]), rtol=0, atol=1e-9)


@given(shapes, surface_tilts, surface_tilts, places)
def test_tangents_and_normal_are_a_right_handed_frame(shape, tilt, tilt_x, p_B):
    frame = np.array(surface_frame(surface(shape, tilt, tilt_x), *p_B)[1:])
    # rounding
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), rtol=0, atol=1e-14)
    assert np.linalg.det(frame) == pytest.approx(1.0, abs=1e-14)


@given(shapes, surface_tilts, surface_tilts)
def test_every_surface_passes_through_its_apex_with_the_axes_of_B_turned_about_x_then_y(shape, tilt, tilt_x):
    found, *frame = surface_frame(surface(shape, tilt, tilt_x), *APEX)
    turned = Rotation.from_euler("y", tilt) * Rotation.from_euler("x", tilt_x)
    assert found == 0.0
    # rounding
    np.testing.assert_allclose(np.array(frame).T, turned.as_matrix(), rtol=0, atol=1e-15)


@given(surface_tilts, surface_tilts, st.tuples(share, share, share), st.floats(-0.01, 0.01))
def test_a_sphere_is_what_is_its_radius_away_from_its_centre(tilt, tilt_x, direction, outside):
    parameters = surface(Shape.SPHERE, tilt, tilt_x)
    n_apex = np.array(surface_frame(parameters, *APEX)[3])
    n = n_apex + 0.5 * np.array(direction)
    n /= np.linalg.norm(n)
    p_B = APEX - RADIUS * n_apex + (RADIUS + outside) * n
    # rounding of lengths of 0.1 m
    assert depth(parameters, p_B) == pytest.approx(-outside, abs=1e-15)
    np.testing.assert_allclose(surface_frame(parameters, *p_B)[3], n, rtol=0, atol=1e-14)


@given(st.sampled_from([Shape.CYLINDER_X, Shape.CYLINDER_Y]), surface_tilts, surface_tilts, places, share)
def test_along_a_cylinders_axis_nothing_changes(shape, tilt, tilt_x, p_B, way):
    parameters = surface(shape, tilt, tilt_x)
    axis = np.array(surface_frame(parameters, *APEX)[1 if shape == Shape.CYLINDER_X else 2])
    here, there = surface_frame(parameters, *p_B), surface_frame(parameters, *(p_B + 0.1 * way * axis))
    # rounding
    assert there[0] == pytest.approx(here[0], abs=1e-15)
    np.testing.assert_allclose(there[1:], here[1:], rtol=0, atol=1e-14)


def test_a_cylinder_falls_off_across_its_axis_only():
    x, y = 0.01, 0.02
    # the sagitta
    lower = RADIUS - np.sqrt(RADIUS**2 - np.array([x, y]) ** 2)
    at = APEX + np.array([x, y, 0.0])
    across_y = depth(surface(Shape.CYLINDER_X), at - np.array([0.0, 0.0, lower[1]]))
    across_x = depth(surface(Shape.CYLINDER_Y), at - np.array([0.0, 0.0, lower[0]]))
    # rounding
    assert (across_y, across_x) == pytest.approx((0.0, 0.0), abs=1e-16)


@given(curved_shapes, surface_tilts, surface_tilts, places, velocities, st.tuples(share, share))
def test_a_surface_of_huge_radius_is_the_plane(shape, tilt, tilt_x, p_B, v, z):
    z_b = 1e-4 * np.array(z)
    flat, curved = surface(Shape.PLANE, tilt, tilt_x), surface(shape, tilt, tilt_x, radius=1e9)
    expected = contact_force(flat, *p_B, *v, *z_b)
    # distance^2 / (2 R) = 1e-12 m of 1250 N/m, five times that with the damping; normals turned by 1e-10
    np.testing.assert_allclose(contact_force(curved, *p_B, *v, *z_b), expected, rtol=0, atol=2e-8)
