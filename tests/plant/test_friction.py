"""Dry friction sticks, slides and takes energy; a hard stop holds and gives back what it took."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import examples
from tests.laws.runs import PARAMETERS, Sampled
from tests.plant.states import moving, positions
from tests.plant.test_energy import LOSSLESS, STEP, energy
from twin.plant.component import STILL, Plant, integrate
from twin.plant.dynamics import UNTOUCHED, joint_torque, settle_friction, winding
from twin.plant.equilibrium import resting
from twin.plant.friction import GRIPPED, HELD, drag, friction_torque, stop_torque, stopped, unstopped
from twin.plant.surface import apex_frame
from twin.robot.geometry import Geometry
from twin.robot.inverse_kinematics import joint_angles

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
    anchors, found = UNTOUCHED.copy(), []
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
    x, theta_m = resting(RUBBED, AIR)
    more = share * TAU_C / (PARAMETERS.k_s * PARAMETERS.N * PARAMETERS.eta)
    step = Sampled(Plant(RUBBED, x, theta_m))
    for _ in range(400):
        y = step.named(theta_m + more, 0.0, 1e-3)
    away = y["theta_l"] - joint_angles(GEOMETRY, x[:3])
    # within the angle that it yields by; without friction it would go ten times as far
    assert np.abs(away).max() < 2.0 * abs(share) * A + 1e-9


def test_a_joint_that_is_pulled_by_more_slides():
    x, theta_m = resting(RUBBED, AIR)
    step = Sampled(Plant(RUBBED, x, theta_m))
    for _ in range(400):
        y = step.named(theta_m + 3.0 * TAU_C / PARAMETERS.N, 0.0, 1e-3)
    assert np.abs(y["theta_l"] - joint_angles(GEOMETRY, x[:3])).min() > 5.0 * A


def kept(parameters, x, anchors, theta_m) -> np.ndarray:
    """Energy (J), (n,), with what is stored in what yields, of states (n, 8) and their anchors (n, 3, 2)."""
    theta_l = joint_angles(GEOMETRY, x[:, :3])
    held = parameters.joint_friction / parameters.joint_presliding * (theta_l - anchors[..., HELD]) ** 2 / 2.0
    d = theta_m - parameters.N * theta_l
    grip = parameters.k_s * (d - anchors[..., GRIPPED]) ** 2 / 2.0 if parameters.spring_hysteresis else 0.0
    over = np.maximum(np.abs(d) - parameters.spring_stop, 0.0)
    out = np.maximum(theta_l - parameters.joint_upper, 0.0) + np.maximum(parameters.joint_lower - theta_l, 0.0)
    yielding = np.sum(held + grip + parameters.stop * (over**2 + out**2) / 2.0, axis=-1)
    return energy(parameters, x, theta_m) + yielding


def history(parameters, x, theta_m, duration: float = 0.05, counted=None) -> np.ndarray:
    """`kept` after each step with the motors held, of the robot `counted` if that is another."""
    x, apex, anchors = x.copy(), apex_frame(parameters), UNTOUCHED.copy()
    x[6:8] = 0.0
    settle_friction(parameters, x, theta_m, anchors)
    found = [(x.copy(), anchors.copy())]
    for _ in range(round(duration / STEP)):
        integrate(parameters, x, theta_m, STILL, STILL, STILL, STEP, apex, anchors)
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
    x, theta_m = resting(ROUGH, AIR)
    x[5] = -0.2
    E = history(ROUGH, x, theta_m, 1.0)
    # half of m v^2 with 0.2 kg is 4 mJ; what it swings with within the angle that it yields by is left
    assert E[0] - E[-1] > 3e-3


def test_a_spring_with_hysteresis_carries_more_while_it_is_wound_and_less_while_it_unwinds():
    d = np.concatenate([np.linspace(0.0, 0.1, 2000), np.linspace(0.1, 0.0, 2000)])
    anchors, wound = UNTOUCHED.copy(), []
    for one in d:
        wound.append(winding(GRIPPING, anchors, 0, one, 0.0))
        drag(GRIPPING, anchors, 0, 0.0, one)
    h, up, down = GRIPPING.spring_hysteresis, wound[:2000], wound[2000:]
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
    x, theta_m = resting(parameters, p_B)
    plant = Plant(parameters, x, theta_m)
    start, step = plant.initial_outputs.copy(), Sampled(plant)
    for _ in range(100):
        end = step(theta_m, 0.0, 1e-3)
    # m, m/s, rad, N m, N: rounding of the balance, under the 17 N of a joint at its stop
    np.testing.assert_allclose(end, start, rtol=0, atol=1e-11)


@given(st.floats(-0.3, 0.3))
def test_a_spring_at_its_stop_is_no_further_than_the_torque_over_the_stiffness(d: float):
    torque = joint_torque(STOPS, 0, stopped(STOPS, d), 0.0) / (STOPS.N * STOPS.eta)
    over = max(abs(d) - STOPS.spring_stop, 0.0)
    assert over <= abs(torque) / STOPS.stop + 1e-15
    assert abs(torque) == pytest.approx(STOPS.k_s * abs(d) + STOPS.stop * over, rel=1e-12)
    assert unstopped(STOPS, stopped(STOPS, d)) == pytest.approx(d, rel=1e-12, abs=1e-15)


def test_a_joint_beyond_its_stop_is_pushed_back_by_the_stiffness_and_within_by_nothing():
    assert stop_torque(STOPS, 0.51) == pytest.approx(-0.01 * STOPS.stop)
    assert stop_torque(STOPS, -0.12) == pytest.approx(0.02 * STOPS.stop)
    assert stop_torque(STOPS, 0.5) == stop_torque(STOPS, -0.1) == stop_torque(NO_STOPS, 2.0) == 0.0


def test_stops_give_back_what_they_took_and_no_more():
    bouncing = LOSSLESS._replace(spring_stop=0.05, joint_lower=-0.1, joint_upper=0.3, stop=100.0)
    x, theta_m = resting(bouncing, AIR)
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
    wound_soft, wound = (resting(p, AIR)[1] - p.N * theta_l for p in (soft, stiff))
    # on the motor's side: 1/k = 1/k_s + N^2 c
    np.testing.assert_allclose(wound_soft / wound, 1.0 + stiff.k_s * stiff.N**2 * 0.1, rtol=1e-12)
    # the joint itself gives way by c per torque on it
    tau = Plant(soft, *resting(soft, AIR)).initial("tau_l")
    np.testing.assert_allclose((wound_soft - wound) / soft.N, 0.1 * tau / soft.eta, rtol=1e-9)


def swung(parameters, step: float, duration: float = 0.1) -> np.ndarray:
    """Positions (m) every millisecond of a robot that swings on its springs, the motors held."""
    x, theta_m = resting(parameters, AIR)
    x[3:6], x[6:8] = (0.05, -0.1, -0.1), 0.0
    apex, anchors, found = apex_frame(parameters), UNTOUCHED.copy(), []
    settle_friction(parameters, x, theta_m, anchors)
    for k in range(round(duration / step)):
        integrate(parameters, x, theta_m, STILL, STILL, STILL, step, apex, anchors)
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
