import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.laws.runs import PARAMETERS
from tests.plant.states import SURFACES, share
from twin.plant.contact import (
    bristle_rate,
    contact_force,
    friction,
    normal_force,
    settled_bristle,
    touch,
)
from twin.plant.surface import Shape, apex_frame, surface_frame

depths = st.floats(1e-6, 0.01)
speeds = st.tuples(share, share, share).map(np.array)
bristles = st.tuples(share, share).map(lambda z: 1e-3 * np.array(z))
tilts = st.floats(-0.7, 0.7)
# in steps, because the smallest floats would only test underflow
coefficients = st.integers(0, 100).map(lambda whole: whole / 100.0)
forces = st.integers(0, 20_000).map(lambda whole: whole / 1000.0)


def touching(depth, tilt=0.0, sideways=(0.0, 0.0)):
    """A position of the platform whose penetration is `depth` (m)."""
    n = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    e_1 = np.array([np.cos(tilt), 0.0, -np.sin(tilt)])
    return np.array([0.0, 0.0, PARAMETERS.z_s]) - depth * n + sideways[0] * e_1 + np.array([0.0, sideways[1], 0.0])


@given(depths, speeds, bristles, tilts)
def test_above_the_surface_nothing_is_felt(depth, v, z_b, tilt):
    parameters = PARAMETERS._replace(tilt=tilt)
    assert contact_force(parameters, *touching(-depth, tilt), *v, *z_b) == (0.0, 0.0, 0.0)


@given(depths, speeds)
def test_normal_force_is_hunt_and_crossley(depth, v):
    F_n, found = normal_force(PARAMETERS, apex_frame(PARAMETERS), *touching(depth), *v)
    expected = PARAMETERS.K * depth * (1.0 - PARAMETERS.damping * v[2])
    # the depth is a difference of numbers near 0.1: 1e-17 m of at least 1e-6
    assert found == pytest.approx(depth, rel=1e-10)
    assert F_n == pytest.approx(max(expected, 0.0), rel=1e-10, abs=1e-12)


@given(depths, st.floats(0.4, 10.0))
def test_a_surface_left_in_haste_does_not_pull(depth, speed):
    F_n, _ = normal_force(PARAMETERS, apex_frame(PARAMETERS), *touching(depth), 0.0, 0.0, speed)
    assert F_n == 0.0


@given(coefficients, forces, bristles, speeds)
def test_friction_never_leaves_the_cone(mu, F_n, z_b, v):
    force = friction(PARAMETERS._replace(mu=mu), F_n, *z_b, v[0], v[1])
    # 1e-12: rounding of a vector shortened to a length
    assert np.hypot(*force) <= mu * F_n * (1.0 + 1e-12)


@given(forces, bristles, speeds)
def test_without_friction_coefficient_the_surface_pushes_along_its_normal_only(F_n, z_b, v):
    smooth = PARAMETERS._replace(mu=0.0)
    assert friction(smooth, F_n, *z_b, v[0], v[1]) == (0.0, 0.0)
    assert settled_bristle(smooth, F_n, *z_b) == (0.0, 0.0)
    assert bristle_rate(smooth, F_n, 0.0, 0.0, v[0], v[1]) == (0.0, 0.0)


@given(speeds, bristles)
def test_a_bristle_that_sticks_is_a_spring_and_a_damper(v, z_b):
    """sigma_0 z_b + sigma_1 v_t of Canudas de Wit's bristle, with a cone that neither 5 kN/m nor 9 N s/m can fill."""
    parameters = PARAMETERS._replace(sigma_0=5000.0, sigma_1=9.0)
    found = friction(parameters, 1e3, *z_b, v[0], v[1])
    # rounding of a sum of two products
    np.testing.assert_allclose(found, 5000.0 * z_b + 9.0 * v[:2], rtol=1e-14, atol=1e-13)


def test_a_platform_that_sticks_swings_on_its_bristle_as_an_oscillator_does():
    """m x'' + sigma_1 x' + sigma_0 x = 0 from a push: the decay of one swing to the next is the damping's."""
    m, sigma_0, sigma_1, h = 0.2, 5000.0, 12.0, 1e-5
    parameters = PARAMETERS._replace(sigma_0=sigma_0, sigma_1=sigma_1)
    x, v, peaks = 0.0, 0.1, []
    for _ in range(12_000):
        before = v
        v -= h / m * friction(parameters, 100.0, x, 0.0, v, 0.0)[0]
        x += h * bristle_rate(parameters, 100.0, x, 0.0, v, 0.0)[0]
        if before > 0.0 >= v:
            peaks.append(x)
    rate = sigma_1 / (2.0 * m)
    period = 2.0 * np.pi / np.sqrt(sigma_0 / m - rate**2)
    # a semi-implicit step of 10 us errs by h sigma_0/(2 m) = 0.13 1/s of 30 1/s, half a per cent
    np.testing.assert_allclose(np.log(np.array(peaks[:-1]) / peaks[1:]), rate * period, rtol=0.01)


@given(coefficients, forces, bristles)
def test_settling_keeps_a_bristle_inside_the_cone_and_its_direction(mu, F_n, z_b):
    settled = np.array(settled_bristle(PARAMETERS._replace(mu=mu), F_n, *z_b))
    limit = mu * F_n / PARAMETERS.sigma_0
    if np.hypot(*z_b) <= limit:
        np.testing.assert_array_equal(settled, z_b)
    else:
        # rounding
        assert np.hypot(*settled) == pytest.approx(limit, rel=1e-12)
        assert z_b[0] * settled[1] - z_b[1] * settled[0] == pytest.approx(0.0, abs=1e-18)


@given(forces, bristles, speeds)
def test_a_sticking_or_released_bristle_follows_the_platform_and_a_sliding_one_does_not_stretch(F_n, z_b, v):
    z_rate = np.array(bristle_rate(PARAMETERS, F_n, *z_b, v[0], v[1]))
    released = F_n > 0.0 and z_b @ v[:2] < 0.0
    if released or PARAMETERS.sigma_0 * np.hypot(*z_b) < PARAMETERS.mu * F_n:
        np.testing.assert_array_equal(z_rate, v[:2])
    else:
        # m * m/s: rounding of a projection of numbers below 1e-3 and 1
        assert z_b @ z_rate <= 1e-18


@given(depths, speeds, bristles, tilts, st.tuples(share, share))
def test_a_tilted_surface_is_the_level_one_turned_about_y(depth, v, z_b, tilt, sideways):
    turn = Rotation.from_euler("y", tilt).as_matrix()
    level = contact_force(PARAMETERS, *touching(depth), *v, *z_b)
    tilted = contact_force(PARAMETERS._replace(tilt=tilt), *touching(depth, tilt, sideways), *(turn @ v), *z_b)
    # depths of 1e-6 m are known to 1e-16 m: 1e-13 N of stiffness, times speeds up to 5
    np.testing.assert_allclose(tilted, turn @ level, rtol=1e-10, atol=1e-11)


@given(depths, speeds, bristles, tilts)
def test_contact_takes_more_power_than_it_stores(depth, v, z_b, tilt):
    """F . v >= d/dt (K depth^2/2 + sigma_0 z_b^2/2): what it does not store it turns into heat."""
    parameters = PARAMETERS._replace(tilt=tilt)
    p_B = touching(depth, tilt)
    _, _, _, n = surface_frame(parameters, *p_B)
    depth_rate = -np.dot(n, v)
    _, found = normal_force(parameters, apex_frame(parameters), *p_B, *v)
    *force, _, dz_1, dz_2 = touch(parameters, apex_frame(parameters), *p_B, *v, *z_b)
    z_rate = np.array([dz_1, dz_2])
    stored = parameters.K * found * depth_rate + parameters.sigma_0 * (z_b @ z_rate)
    taken = np.dot(force, v)
    # rounding of powers up to 100 W
    assert taken - stored >= -1e-13


@given(
    st.sampled_from(sorted(SURFACES)),
    st.sampled_from(
        [{}, {"shape": int(Shape.SPHERE), "radius": 0.06}, {"shape": int(Shape.CYLINDER_X), "radius": 0.04}]
    ),
    tilts,
    tilts,
    st.tuples(share, share, share),
    speeds,
    bristles,
)
def test_on_every_surface_the_force_is_normal_and_tangential_within_the_cone(law, shape, tilt, tilt_x, place, v, z_b):
    parameters = SURFACES[law]._replace(tilt=tilt, tilt_x=tilt_x, **shape)
    p_B = np.array([0.0, 0.0, PARAMETERS.z_s]) + 0.02 * np.array(place)
    _, e_1, e_2, n = surface_frame(parameters, *p_B)
    F_n, _ = normal_force(parameters, apex_frame(parameters), *p_B, *v)
    force = np.array(contact_force(parameters, *p_B, *v, *z_b))
    # rounding of forces up to 1 kN
    assert force @ n == pytest.approx(-F_n, abs=1e-11)
    assert np.hypot(force @ e_1, force @ e_2) <= parameters.mu * F_n + 1e-11
