"""Energy with the drives locked: it never grows, and without any loss it stays."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import examples
from tests.laws.runs import PARAMETERS
from tests.robot.plant.kinetic import kinetic_energy
from tests.robot.plant.states import SURFACES, moving
from twin.robot.mechanism.geometry import NO_ANCHOR, Geometry
from twin.robot.mechanism.kinematics import jacobian, joint_angles
from twin.robot.mechanism.statics import G_ACCELERATION, platform_weight
from twin.robot.plant.component import NO_MOTION, integrate
from twin.robot.plant.contact import Shape, apex_frame, normal_force
from twin.robot.plant.contact_law import ContactLaw
from twin.robot.plant.dynamics import spring_deflection

STEP = 1e-4
LOSSLESS = PARAMETERS._replace(b_j=0.0, damping=0.0, mu=0.0, backlash=0.0)


def stored(parameters, d):
    """Potential (J) of the surface's elastic force at depth `d`: its integral."""
    if parameters.law == ContactLaw.EXPONENTIAL:
        beta = parameters.stiffening
        return parameters.K / beta**2 * (np.expm1(beta * d) - beta * d)
    n = parameters.exponent
    return parameters.K * parameters.reference_depth ** (1.0 - n) * d ** (n + 1.0) / (n + 1.0)


def energy(parameters, x, theta_m):
    """Kinetic, of weight, springs, surface and bristle together (J), (n,), of states (n, 8)."""
    geometry = Geometry(parameters.a, parameters.b, parameters.l_a, parameters.l_b)
    p_B, v_B, bristle = x[:, :3], x[:, 3:6], x[:, 6:8]
    theta_l, omega_l = joint_angles(geometry, p_B), (jacobian(geometry, p_B) @ v_B[..., None])[..., 0]
    d = np.array([[spring_deflection(parameters, leg, theta_m[leg], row[leg]) for leg in range(3)] for row in theta_l])
    apex = apex_frame(parameters)
    depth = np.array([normal_force(parameters, apex, *row[:6])[1] for row in x])
    arm_moment = (parameters.m_a + parameters.m_b) / 2.0 * parameters.l_a
    return (
        kinetic_energy(parameters, theta_l, omega_l, v_B)
        + platform_weight(parameters) * p_B[:, 2]
        - arm_moment * G_ACCELERATION * np.sin(theta_l).sum(axis=-1)
        + parameters.k_s * (d**2 @ np.array(parameters.k_s_share)) / 2.0
        + stored(parameters, np.maximum(depth, 0.0))
        + parameters.sigma_0 * np.sum(bristle**2, axis=-1) / 2.0
    )


def energies(parameters, x, theta_m, duration=0.05):
    """Energy (J) at each step of a free motion with the motors held, shape (steps + 1,)."""
    x, apex = x.copy(), apex_frame(parameters)
    # a bristle longer than the cone allows is no state the robot can be in
    integrate(parameters, x, theta_m, NO_MOTION, NO_MOTION, NO_MOTION, 0.0, apex, NO_ANCHOR)
    states = [x.copy()]
    for _ in range(round(duration / STEP)):
        integrate(parameters, x, theta_m, NO_MOTION, NO_MOTION, NO_MOTION, STEP, apex, NO_ANCHOR)
        states.append(x.copy())
    return energy(parameters, np.array(states), theta_m)


@examples(15)
@given(moving(), st.sampled_from([0.0, 0.2]))
def test_energy_never_grows_while_the_drives_are_locked(state, tilt):
    parameters = PARAMETERS._replace(tilt=tilt)
    E = energies(parameters, *state)
    # 1e-7 J: a Runge-Kutta step across a touch-down, of the order of K (v h)^2, in motions with 10 mJ
    assert np.diff(E).max() <= 1e-7


@examples(40)
@given(
    moving(),
    st.sampled_from(sorted(SURFACES)),
    st.sampled_from(
        [
            (int(Shape.PLANE), 1.0),
            (int(Shape.SPHERE), 0.05),
            (int(Shape.CYLINDER_X), 0.04),
            (int(Shape.CYLINDER_Y), 0.06),
        ]
    ),
    st.sampled_from([0.0, 0.3]),
)
def test_energy_never_grows_on_any_surface(state, law, shape, tilt_x):
    parameters = SURFACES[law]._replace(shape=shape[0], radius=shape[1], tilt_x=tilt_x, tilt=0.2)
    # as above
    assert np.diff(energies(parameters, *state)).max() <= 1e-7


@examples(15)
@given(moving(parameters=LOSSLESS))
def test_energy_stays_without_friction_and_damping(state):
    E = energies(LOSSLESS, *state)
    # 1e-7 J: touch-down inside a step, of the order of K (v h)^2; in free flight it is 1e-12
    assert np.ptp(E) <= 1e-7


@examples(15)
@given(moving(), st.floats(0.7, 0.95), st.floats(0.1, 1.0))
def test_a_belt_whose_efficiency_depends_on_direction_only_loses_energy(state, eta, eta_rate):
    lossy = LOSSLESS._replace(eta=eta, eta_rate=eta_rate)
    E = energies(lossy, *state)
    # as above
    assert np.diff(E).max() <= 1e-7


def test_a_belt_that_loses_energy_brings_the_robot_to_rest():
    x = np.array([0.0, 0.0, -0.090, 0.0, 0.0, -0.2, 0.0, 0.0])
    theta_m = PARAMETERS.N * joint_angles(Geometry(*PARAMETERS[:4]), x[:3])
    start, *_, end = energies(LOSSLESS._replace(eta=0.8, eta_rate=0.05), x, theta_m, 1.0)
    lossless = energies(LOSSLESS, x, theta_m, 1.0)
    assert start - end > 1e-3
    assert abs(lossless[-1] - lossless[0]) < 1e-8


def test_the_papers_constant_efficiency_gives_back_what_it_took():
    """Eq. 18 with eta < 1 is a softer spring, not a loss: driven backwards, the belt returns the power."""
    soft = LOSSLESS._replace(eta=0.8)
    x = np.array([0.0, 0.0, -0.090, 0.0, 0.0, -0.2, 0.0, 0.0])
    theta_m = PARAMETERS.N * joint_angles(Geometry(*PARAMETERS[:4]), x[:3])
    equivalent = LOSSLESS._replace(k_s=0.8 * LOSSLESS.k_s)
    end, same = x.copy(), x.copy()
    scratch = apex_frame(soft), NO_ANCHOR
    for _ in range(1000):
        integrate(soft, end, theta_m, NO_MOTION, NO_MOTION, NO_MOTION, STEP, *scratch)
        integrate(equivalent, same, theta_m, NO_MOTION, NO_MOTION, NO_MOTION, STEP, *scratch)
    # rounding over 1000 steps
    np.testing.assert_allclose(end, same, rtol=0, atol=1e-12)
