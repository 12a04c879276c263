"""Worn, slipped and broken joints."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import examples
from tests.laws.runs import PARAMETERS, ComponentStepper
from tests.robot.plant.kinetic import mass_matrix
from tests.robot.plant.states import moving, positions, share
from tests.robot.plant.test_energy import energies
from twin.robot.experiment.fault import FAULT_KINDS
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import jacobian, joint_angles
from twin.robot.plant.component import NO_MOTION, Plant, rest_state
from twin.robot.plant.dynamics import Triple, derivative, joint_torque, spring_deflection

GEOMETRY = Geometry(*PARAMETERS[:4])
AIR = (0.0, 0.01, -0.090)
fractions = st.tuples(share, share, share).map(lambda values: tuple(abs(value) for value in values))


def scaled(factor, values) -> Triple:
    one, two, three = (float(factor * value) for value in values)
    return one, two, three


def acceleration(parameters, x, theta_m):
    dx = np.empty(8)
    derivative(parameters, x, theta_m, NO_MOTION, NO_MOTION, dx)
    return dx[3:6]


@given(positions(highest=-0.102))
def test_half_a_spring_winds_up_twice_as_far_under_the_same_load(p_B):
    stiff = PARAMETERS._replace(backlash=0.0)
    deflection = rest_state(stiff, p_B)[1] - rest_state(stiff._replace(k_s=1e9), p_B)[1]
    soft = rest_state(stiff._replace(k_s_share=(1.0, 0.5, 1.0)), p_B)[1] - rest_state(stiff._replace(k_s=1e9), p_B)[1]
    # rounding, and 1e-9 of a turn left by the stiffest spring
    np.testing.assert_allclose(soft, deflection * [1.0, 2.0, 1.0], rtol=0, atol=1e-8)


@given(moving())
def test_a_broken_spring_carries_nothing_on_either_side(state):
    y = Plant(PARAMETERS._replace(k_s_share=(1.0, 0.0, 1.0)), *state)
    whole = Plant(PARAMETERS, *state)
    assert y.initial("tau_l")[1] == y.initial("tau_load")[1] == 0.0
    np.testing.assert_array_equal(y.initial("tau_l")[[0, 2]], whole.initial("tau_l")[[0, 2]])


def test_a_broken_spring_drops_the_platform_on_that_side():
    x, theta_m = rest_state(PARAMETERS, AIR)
    broken = ComponentStepper(Plant(PARAMETERS._replace(k_s_share=(0.0, 1.0, 1.0)), x, theta_m))
    for _ in range(200):
        y = broken.outputs_by_port(theta_m, 0.0, 1e-3)
    assert y["p_B"][2] < AIR[2] - 2e-3
    # positive theta_l lowers
    assert y["theta_l"][0] - Plant(PARAMETERS, x, theta_m).initial("theta_l")[0] > 0.05


@given(positions(), st.tuples(share, share, share))
def test_a_slipped_belt_shifts_its_joint_by_the_slip_over_the_belt_ratio(p_B, shares):
    """The motor has to go on by the slip to hold the joint where it was; held still, it leaves it slip / N behind."""
    slip = scaled(0.2, shares)
    theta_m = rest_state(PARAMETERS, p_B)[1]
    # rounding of angles near 1 rad
    np.testing.assert_allclose(rest_state(PARAMETERS._replace(slip=slip), p_B)[1], theta_m + slip, rtol=0, atol=1e-15)
    for leg in range(3):
        same = spring_deflection(PARAMETERS, leg, 1.0, 0.5)
        behind = spring_deflection(PARAMETERS._replace(slip=slip), leg, 1.0, 0.5 - slip[leg] / PARAMETERS.N)
        assert behind == pytest.approx(same, abs=1e-15)


@given(positions(), fractions, fractions, st.tuples(share, share, share))
def test_worn_joints_rest_too(p_B, springs, wear, slip):
    worn = PARAMETERS._replace(
        k_s_share=tuple(1.0 - 0.9 * gone for gone in springs),
        backlash_added=scaled(0.1, wear),
        b_j_added=scaled(0.02, wear),
        slip=scaled(0.1, slip),
    )
    # rounding of forces up to 20 N, on 0.2 kg, through angles of 10 rad
    np.testing.assert_allclose(acceleration(worn, *rest_state(worn, p_B)), 0.0, rtol=0, atol=1e-11)


@given(st.integers(0, 2), share)
def test_added_backlash_widens_the_dead_zone_of_its_joint_alone(leg, deflection):
    added = scaled(0.3, np.eye(3)[leg])
    worn = PARAMETERS._replace(backlash_added=added)
    for other in range(3):
        half = PARAMETERS.backlash + added[other]
        expected = np.sign(deflection) * max(abs(deflection) - half, 0.0)
        assert spring_deflection(worn, other, deflection, 0.0) == pytest.approx(expected, abs=1e-15)


@given(moving(), fractions)
def test_added_friction_brakes_its_joint(state, added):
    x, theta_m = state
    J = jacobian(GEOMETRY, x[:3])
    worn, whole = PARAMETERS._replace(b_j_added=added), PARAMETERS
    M = np.linalg.inv(np.column_stack([mobility(whole, x, theta_m, e) for e in np.eye(3)]))
    brake = M @ (acceleration(worn, x, theta_m) - acceleration(whole, x, theta_m))
    # N; differences of forces of 1e3 N
    np.testing.assert_allclose(brake, -J.T @ (np.array(added) * (J @ x[3:6])), rtol=1e-6, atol=1e-6)


def test_the_most_friction_that_a_fault_may_add_is_stable_in_steps_of_1_ms():
    b = np.diag([PARAMETERS.b_j + FAULT_KINDS["joint_friction"].bounds["le"], PARAMETERS.b_j, PARAMETERS.b_j])
    fastest = 0.0
    # the monitor's cylinder at its upper edge, where joints turn most per mm, and at its lower one
    for z in (-0.075, -0.135):
        for r in np.linspace(0.0, 0.04, 9):
            for phi in np.radians(np.arange(0.0, 360.0, 15.0)):
                p_B = np.array([r * np.cos(phi), r * np.sin(phi), z])
                J = jacobian(GEOMETRY, p_B)
                M = mass_matrix(PARAMETERS, joint_angles(GEOMETRY, p_B), J)
                fastest = max(fastest, np.linalg.eigvals(np.linalg.solve(M, J.T @ b @ J)).real.max())
    # classical Runge-Kutta is stable down to -2.785 on the real axis; 0.05 N m s/rad more would not be
    assert 2700.0 < fastest < 2785.0


def mobility(parameters, x, theta_m, force):
    """Acceleration (3,) per newton along `force`, from the joint torques that make it: J^-T f."""
    torques = np.linalg.solve(jacobian(GEOMETRY, x[:3]).T, force)
    # an unloaded, lossless spring turns motor angles into torques without a dead zone
    free = parameters._replace(backlash=0.0)
    turned = acceleration(free, x, theta_m + torques / (free.k_s * free.N * free.eta))
    return turned - acceleration(free, x, theta_m)


@examples(15)
@given(moving(), fractions, fractions, st.tuples(share, share, share))
def test_energy_never_grows_in_worn_joints(state, springs, wear, slip):
    worn = PARAMETERS._replace(
        k_s_share=springs,
        backlash_added=scaled(0.1, wear),
        b_j_added=scaled(0.02, wear),
        slip=scaled(0.1, slip),
    )
    # as in test_energy.py: a Runge-Kutta step across a touch-down
    assert np.diff(energies(worn, *state)).max() <= 1e-7


@given(st.integers(0, 2), share, share)
def test_worn_springs_keep_the_losses_of_a_belt_whose_efficiency_depends_on_direction(leg, d, omega_l):
    lossy = PARAMETERS._replace(eta=0.8, eta_rate=0.2, k_s_share=(0.5, 0.5, 0.5))
    softer = PARAMETERS._replace(eta=0.8, eta_rate=0.2, k_s=0.5 * PARAMETERS.k_s)
    assert joint_torque(lossy, leg, d, omega_l) == joint_torque(softer, leg, d, omega_l)
