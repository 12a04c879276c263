"""Dry friction sticks, slides and takes energy; a hard stop holds and gives back what it took."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.conftest import examples
from tests.laws.runs import PARAMETERS, ComponentStepper
from tests.robot.plant.states import SURFACES, moving, positions, share
from tests.robot.plant.test_energy import LOSSLESS, STEP, energy
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import joint_angles
from twin.robot.plant.component import NO_MOTION, Plant, integrate, rest_state
from twin.robot.plant.contact import (
    JOINT_ANCHOR,
    SPRING_ANCHOR,
    Shape,
    apex_frame,
    bristle_rate,
    contact_force,
    friction,
    normal_force,
    settled_bristle,
    surface_frame,
    touch,
)
from twin.robot.plant.dynamics import INITIAL_ANCHORS, joint_torque, loaded_deflection, settle_friction
from twin.robot.plant.joints import drag, friction_torque, inverse_stop_deflection, stop_deflection, stop_torque

GEOMETRY = Geometry(*PARAMETERS[:4])
TAU_C, A = 0.01, 2e-4
RUBBED = PARAMETERS._replace(joint_friction=TAU_C, joint_presliding=A)
GRIPPING = PARAMETERS._replace(spring_hysteresis=0.1, backlash=0.0)
STOPS = PARAMETERS._replace(spring_stop=0.05, joint_lower=-0.1, joint_upper=0.5)
NO_STOPS = PARAMETERS._replace(spring_stop=np.inf, joint_lower=-np.inf, joint_upper=np.inf)
AIR = (0.0, 0.01, -0.090)


def there_and_back(amplitude: float, steps: int = 4000) -> np.ndarray:
    """Two cycles of a triangle between +-amplitude, the second of which is closed."""
    up = np.linspace(-amplitude, amplitude, steps)
    return np.concatenate([up, up[::-1], up, up[::-1]])


def torques(parameters, path: np.ndarray) -> np.ndarray:
    """Friction of joint 1 along the angles `path`, as a plant goes along them: evaluated, then dragged."""
    anchors, found = INITIAL_ANCHORS.copy(), []
    for theta in path:
        found.append(friction_torque(parameters, anchors, 0, theta))
        drag(parameters, anchors, 0, theta, 0.0)
    return np.array(found)


@pytest.mark.parametrize("amplitude", [0.01, 0.1])
def test_a_joint_that_goes_to_and_fro_loses_four_times_its_friction_times_the_amplitude(amplitude: float):
    path = there_and_back(amplitude)
    tau = torques(RUBBED, path)
    assert np.abs(tau).max() == TAU_C
    cycle = slice(len(path) // 2, None)
    lost = np.trapezoid(tau[cycle], path[cycle])
    # what yields elastically at each turn is given back; one step of the path of the 2000 that it takes
    assert lost == pytest.approx(4.0 * TAU_C * (amplitude - A), rel=1e-3)


@given(st.floats(-0.45, 0.45))
def test_a_joint_that_is_pulled_by_less_than_its_friction_stays_where_it_is(share: float):
    """In air, motors turned at once so far that springs pull by a share of the friction more: it swings to twice."""
    x, theta_m = rest_state(RUBBED, AIR)
    more = share * TAU_C / (PARAMETERS.k_s * PARAMETERS.N * PARAMETERS.eta)
    step = ComponentStepper(Plant(RUBBED, x, theta_m))
    for _ in range(400):
        y = step.outputs_by_port(theta_m + more, 0.0, 1e-3)
    away = y["theta_l"] - joint_angles(GEOMETRY, x[:3])
    # within the angle that it yields by; without friction it would go ten times as far
    assert np.abs(away).max() < 2.0 * abs(share) * A + 1e-9


def test_a_joint_that_is_pulled_by_more_slides():
    x, theta_m = rest_state(RUBBED, AIR)
    step = ComponentStepper(Plant(RUBBED, x, theta_m))
    for _ in range(400):
        y = step.outputs_by_port(theta_m + 3.0 * TAU_C / PARAMETERS.N, 0.0, 1e-3)
    assert np.abs(y["theta_l"] - joint_angles(GEOMETRY, x[:3])).min() > 5.0 * A


def kept(parameters, x, anchors, theta_m) -> np.ndarray:
    """Energy (J), (n,), with what is stored in what yields, of states (n, 8) and their anchors (n, 3, 2)."""
    theta_l = joint_angles(GEOMETRY, x[:, :3])
    held = parameters.joint_friction / parameters.joint_presliding * (theta_l - anchors[..., JOINT_ANCHOR]) ** 2 / 2.0
    d = theta_m - parameters.N * theta_l
    grip = parameters.k_s * (d - anchors[..., SPRING_ANCHOR]) ** 2 / 2.0 if parameters.spring_hysteresis else 0.0
    over = np.maximum(np.abs(d) - parameters.spring_stop, 0.0)
    out = np.maximum(theta_l - parameters.joint_upper, 0.0) + np.maximum(parameters.joint_lower - theta_l, 0.0)
    yielding = np.sum(held + grip + parameters.stop * (over**2 + out**2) / 2.0, axis=-1)
    return energy(parameters, x, theta_m) + yielding


def history(parameters, x, theta_m, duration: float = 0.05, counted=None) -> np.ndarray:
    """`kept` after each step with the motors held, of the robot `counted` if that is another."""
    x, apex, anchors = x.copy(), apex_frame(parameters), INITIAL_ANCHORS.copy()
    x[6:8] = 0.0
    settle_friction(parameters, x, theta_m, anchors)
    found = [(x.copy(), anchors.copy())]
    for _ in range(round(duration / STEP)):
        integrate(parameters, x, theta_m, NO_MOTION, NO_MOTION, NO_MOTION, STEP, apex, anchors)
        found.append((x.copy(), anchors.copy()))
    states, held = map(np.array, zip(*found, strict=True))
    return kept(counted or parameters, states, held, theta_m)


ROUGH = LOSSLESS._replace(joint_friction=TAU_C, joint_presliding=A, spring_hysteresis=0.1)


@examples(15)
@given(moving(parameters=ROUGH))
def test_dry_friction_takes_energy_and_never_makes_any(state):
    E = history(ROUGH, *state)
    # 1e-7 J: a step in which something breaks loose or touches down, in motions with 10 mJ
    assert np.diff(E).max() <= 1e-7


def test_dry_friction_brings_a_robot_without_any_other_loss_to_rest():
    x, theta_m = rest_state(ROUGH, AIR)
    x[5] = -0.2
    E = history(ROUGH, x, theta_m, 1.0)
    # half of m v^2 with 0.2 kg is 4 mJ; what it swings with within the angle that it yields by is left
    assert E[0] - E[-1] > 3e-3


def test_a_spring_with_hysteresis_carries_more_while_its_deflection_grows_and_less_while_it_shrinks():
    d = np.concatenate([np.linspace(0.0, 0.1, 2000), np.linspace(0.1, 0.0, 2000)])
    anchors, deflection = INITIAL_ANCHORS.copy(), []
    for one in d:
        deflection.append(loaded_deflection(GRIPPING, anchors, 0, one, 0.0))
        drag(GRIPPING, anchors, 0, 0.0, one)
    h, up, down = GRIPPING.spring_hysteresis, deflection[:2000], deflection[2000:]
    np.testing.assert_allclose(up[1:], (1.0 + h) * d[1:2000], rtol=1e-12)
    # unwinding it turns over within 2 h of the deflection, and carries nothing where it is slack
    late = d[2000:] < (1.0 - 2.0 * h) * 0.1
    np.testing.assert_allclose(np.array(down)[late], (1.0 - h) * d[2000:][late], rtol=0, atol=1e-12)
    # the loop: 2 h k d^2/2, less the corner in which it turns over
    area = GRIPPING.k_s * (np.trapezoid(up, d[:2000]) + np.trapezoid(down, d[2000:]))
    assert 0.8 * h * 0.1**2 < area < h * 0.1**2


@given(positions(), st.floats(-0.5, 0.5))
def test_a_robot_with_all_of_them_starts_at_rest_and_stays(p_B, tilt):
    parameters = PARAMETERS._replace(
        joint_friction=2e-3, spring_hysteresis=0.02, belt_compliance=0.004, spring_stop=0.05, joint_upper=0.3,
        mounting_tilt=tilt, mounting_tilt_x=0.3, head=(0.003, -0.002, -0.001),
    )  # fmt: skip
    x, theta_m = rest_state(parameters, p_B)
    plant = Plant(parameters, x, theta_m)
    start, step = plant.initial_outputs.copy(), ComponentStepper(plant)
    for _ in range(100):
        end = step(theta_m, 0.0, 1e-3)
    # m, m/s, rad, N m, N: rounding of the balance, under the 17 N of a joint at its stop
    np.testing.assert_allclose(end, start, rtol=0, atol=1e-11)


@given(st.floats(-0.3, 0.3))
def test_a_spring_at_its_stop_is_no_further_than_the_torque_over_the_stiffness(d: float):
    torque = joint_torque(STOPS, 0, stop_deflection(STOPS, d), 0.0) / (STOPS.N * STOPS.eta)
    over = max(abs(d) - STOPS.spring_stop, 0.0)
    assert over <= abs(torque) / STOPS.stop + 1e-15
    assert abs(torque) == pytest.approx(STOPS.k_s * abs(d) + STOPS.stop * over, rel=1e-12)
    assert inverse_stop_deflection(STOPS, stop_deflection(STOPS, d)) == pytest.approx(d, rel=1e-12, abs=1e-15)


def test_a_joint_beyond_its_stop_is_pushed_back_by_the_stiffness_and_within_by_nothing():
    assert stop_torque(STOPS, 0.51) == pytest.approx(-0.01 * STOPS.stop)
    assert stop_torque(STOPS, -0.12) == pytest.approx(0.02 * STOPS.stop)
    assert stop_torque(STOPS, 0.5) == stop_torque(STOPS, -0.1) == stop_torque(NO_STOPS, 2.0) == 0.0


def test_stops_give_back_what_they_took_and_no_more():
    bouncing = LOSSLESS._replace(spring_stop=0.05, joint_lower=-0.1, joint_upper=0.3, stop=100.0)
    x, theta_m = rest_state(bouncing, AIR)
    x[5] = -0.4
    E = history(bouncing, x, theta_m, 0.4)
    # a step across a corner, of the order of k (omega h)^2 with N^2 100 N m/rad and 5 rad/s
    assert np.ptp(E) < 1e-4
    # and they have held 8 mJ on the way
    assert np.ptp(history(bouncing, x, theta_m, 0.4, LOSSLESS)) > 5e-3


def test_a_belt_that_yields_is_a_second_spring_in_series():
    soft = PARAMETERS._replace(belt_compliance=0.1, backlash=0.0)
    stiff = soft._replace(belt_compliance=0.0)
    theta_l = joint_angles(GEOMETRY, AIR)
    deflection_soft, deflection = (rest_state(p, AIR)[1] - p.N * theta_l for p in (soft, stiff))
    # on the motor's side: 1/k = 1/k_s + N^2 c
    np.testing.assert_allclose(deflection_soft / deflection, 1.0 + stiff.k_s * stiff.N**2 * 0.1, rtol=1e-12)
    # the joint itself gives way by c per torque on it
    tau = Plant(soft, *rest_state(soft, AIR)).initial("tau_l")
    np.testing.assert_allclose((deflection_soft - deflection) / soft.N, 0.1 * tau / soft.eta, rtol=1e-9)


def swung(parameters, step: float, duration: float = 0.1) -> np.ndarray:
    """Positions (m) every millisecond of a robot that swings on its springs, the motors held."""
    x, theta_m = rest_state(parameters, AIR)
    x[3:6], x[6:8] = (0.05, -0.1, -0.1), 0.0
    apex, anchors, found = apex_frame(parameters), INITIAL_ANCHORS.copy(), []
    settle_friction(parameters, x, theta_m, anchors)
    for k in range(round(duration / step)):
        integrate(parameters, x, theta_m, NO_MOTION, NO_MOTION, NO_MOTION, step, apex, anchors)
        if (k + 1) % round(1e-3 / step) == 0:
            found.append(x[:3].copy())
    return np.array(found)


def test_hysteresis_converges_unevenly_and_by_two_orders_less_than_what_is_smooth():
    """A step does not hit the corner at which a spring turns."""
    finer = (1, 2, 4, 8, 16)

    def errors(parameters) -> np.ndarray:
        reference = swung(parameters, 1e-3 / 256)
        return np.array([np.abs(swung(parameters, 1e-3 / share) - reference).max() for share in finer])

    smooth, gripping = (errors(LOSSLESS._replace(spring_hysteresis=h, backlash=0.0)) for h in (0.0, 0.1))
    orders = [-np.polyfit(np.log(finer), np.log(found), 1)[0] for found in (smooth, gripping)]
    assert orders[0] == pytest.approx(4.0, abs=0.1) and 1.5 < orders[1] < 2.5
    halvings = np.log2(gripping[:-1] / gripping[1:])
    # so from two runs no third one can be foreseen
    assert np.ptp(halvings) > 1.0


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
