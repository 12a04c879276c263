import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.laws.runs import PARAMETERS
from tests.plant.states import share
from twin.plant.contact import contact_force
from twin.plant.surface import Shape, surface_frame

shapes = st.sampled_from([int(shape) for shape in Shape])
curved_shapes = st.sampled_from([int(shape) for shape in Shape if shape != Shape.PLANE])
tilts = st.integers(-60, 60).map(lambda degrees: np.radians(degrees))
APEX = np.array([0.0, 0.0, PARAMETERS.z_s])
places = st.tuples(share, share, share).map(lambda place: APEX + 0.02 * np.array(place))
velocities = st.tuples(share, share, share).map(np.array)
RADIUS = 0.05


def surface(shape: int, tilt=0.0, tilt_x=0.0, radius=RADIUS):
    return PARAMETERS._replace(shape=int(shape), tilt=tilt, tilt_x=tilt_x, radius=radius)


def depth(parameters, p_B):
    return surface_frame(parameters, *p_B)[0]


@given(shapes, tilts, tilts, places)
def test_depth_grows_against_the_normal(shape, tilt, tilt_x, p_B):
    parameters = surface(shape, tilt, tilt_x)
    step = 1e-6
    gradient = [(depth(parameters, p_B + e) - depth(parameters, p_B - e)) / (2.0 * step) for e in step * np.eye(3)]
    # central difference: rounding 1e-17 / 1e-6, curvature (step/R)^2
    np.testing.assert_allclose(gradient, -np.array(surface_frame(parameters, *p_B)[3]), rtol=0, atol=1e-9)


@given(shapes, tilts, tilts, places)
def test_tangents_and_normal_are_a_right_handed_frame(shape, tilt, tilt_x, p_B):
    frame = np.array(surface_frame(surface(shape, tilt, tilt_x), *p_B)[1:])
    # rounding
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), rtol=0, atol=1e-14)
    assert np.linalg.det(frame) == pytest.approx(1.0, abs=1e-14)


@given(shapes, tilts, tilts)
def test_every_surface_passes_through_its_apex_with_the_axes_of_B_turned_about_x_then_y(shape, tilt, tilt_x):
    found, *frame = surface_frame(surface(shape, tilt, tilt_x), *APEX)
    turned = Rotation.from_euler("y", tilt) * Rotation.from_euler("x", tilt_x)
    assert found == 0.0
    # rounding
    np.testing.assert_allclose(np.array(frame).T, turned.as_matrix(), rtol=0, atol=1e-15)


@given(tilts, tilts, st.tuples(share, share, share), st.floats(-0.01, 0.01))
def test_a_sphere_is_what_is_its_radius_away_from_its_centre(tilt, tilt_x, direction, outside):
    parameters = surface(Shape.SPHERE, tilt, tilt_x)
    n_apex = np.array(surface_frame(parameters, *APEX)[3])
    n = n_apex + 0.5 * np.array(direction)
    n /= np.linalg.norm(n)
    p_B = APEX - RADIUS * n_apex + (RADIUS + outside) * n
    # rounding of lengths of 0.1 m
    assert depth(parameters, p_B) == pytest.approx(-outside, abs=1e-15)
    np.testing.assert_allclose(surface_frame(parameters, *p_B)[3], n, rtol=0, atol=1e-14)


@given(st.sampled_from([Shape.CYLINDER_X, Shape.CYLINDER_Y]), tilts, tilts, places, share)
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


@given(curved_shapes, tilts, tilts, places, velocities, st.tuples(share, share))
def test_a_surface_of_huge_radius_is_the_plane(shape, tilt, tilt_x, p_B, v, z):
    z_b = 1e-4 * np.array(z)
    flat, curved = surface(Shape.PLANE, tilt, tilt_x), surface(shape, tilt, tilt_x, radius=1e9)
    expected = contact_force(flat, *p_B, *v, *z_b)
    # distance^2 / (2 R) = 1e-12 m of 1250 N/m, five times that with the damping; normals turned by 1e-10
    np.testing.assert_allclose(contact_force(curved, *p_B, *v, *z_b), expected, rtol=0, atol=2e-8)
