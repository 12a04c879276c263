"""What the motors do besides moving the platform: friction forces, and the springs' wind-up for them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.controller.test_controller import GEOMETRY
from tests.plant.states import positions
from twin.controller.feed_forward import REST_SPEED, friction_force, load_torques
from twin.robot.jacobian import jacobian

newtons = st.floats(-10.0, 10.0)


@given(positions(), newtons, newtons, newtons)
def test_load_torques_do_the_work_of_the_force(p_B, F_x, F_y, F_z):
    J = jacobian(GEOMETRY, p_B)
    tau_l = load_torques(J.ravel(), F_x, F_y, F_z)
    # virtual work: J^T tau = F; rounding of forces below 20 N
    np.testing.assert_allclose(J.T @ tau_l, [F_x, F_y, F_z], rtol=0, atol=1e-13)
    np.testing.assert_allclose(tau_l, np.linalg.solve(J.T, [F_x, F_y, F_z]), rtol=0, atol=1e-13)


@given(st.floats(0.0, 1.0), st.floats(0.0, 10.0), st.floats(0.01, 0.2), st.floats(0.0, 2.0 * np.pi))
def test_friction_pulls_the_surface_along_with_mu_times_the_normal_force(mu, F_n, speed, angle):
    v = speed * np.array([np.cos(angle), np.sin(angle)])
    F = np.array(friction_force(mu, F_n, *v))
    # rounding
    assert abs(F[0] * v[1] - F[1] * v[0]) <= 1e-15
    assert F @ v >= 0.0
    # the fading takes (REST_SPEED/speed)^2/2 of it, 0.5 % at 10 mm/s; rounding of forces below 10 N
    assert mu * F_n * (1.0 - 0.5 * (REST_SPEED / speed) ** 2) - 1e-12 <= np.hypot(*F) <= mu * F_n + 1e-12


def test_friction_fades_out_at_rest_and_changes_sign_with_the_motion():
    assert friction_force(0.22, 5.0, 0.0, 0.0) == (0.0, 0.0)
    there, back = friction_force(0.22, 5.0, 0.0, 1e-4), friction_force(0.22, 5.0, 0.0, -1e-4)
    assert there[1] == -back[1] > 0.0
    # a tenth of the rest speed: a tenth of the friction, less 0.5 %
    assert there[1] == pytest.approx(0.1 * 0.22 * 5.0, rel=0.006)


def test_the_force_of_friction_never_jumps():
    v = np.linspace(-0.02, 0.02, 4001)
    F = np.array([friction_force(0.22, 5.0, x, 0.0)[0] for x in v])
    # nowhere steeper than at rest, mu F_n/REST_SPEED
    assert np.diff(F).max() <= 0.22 * 5.0 / REST_SPEED * (v[1] - v[0]) * (1.0 + 1e-9)
    assert np.diff(F).min() >= 0.0
