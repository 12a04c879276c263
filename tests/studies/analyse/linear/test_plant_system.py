import control
import numpy as np
import pytest
from hypothesis import given

from tests.laws.runs import PARAMETERS
from tests.robot.plant.states import moving
from twin.robot.plant.component import OUTPUTS, Plant, resting
from twin.studies.analyse.linear.plant_system import STATE_LABELS, plant_system, signal_labels

SYSTEM = plant_system(PARAMETERS)


def jacobian_by_differences(f, z):
    """df/dz by central differences of two steps and Richardson's extrapolation: error of order step^4."""

    def central(step):
        columns = [f(z + step * e) - f(z - step * e) for e in np.eye(len(z))]
        return np.stack(columns, axis=-1) / (2.0 * step)

    # 2e-5 m and rad: truncation and rounding are both near 1e-9
    return (4.0 * central(1e-5) - central(2e-5)) / 3.0


def still(x, y, z):
    return resting(PARAMETERS, (x, y, z))


def sticking():
    x, theta_m = still(0.005, -0.02, -0.105)
    x[3:] = [0.01, -0.02, 0.03, 5e-5, -8e-5]
    return x, theta_m


def moving_in_air():
    x, theta_m = still(-0.01, 0.01, -0.09)
    x[3:6] = [0.2, -0.1, 0.15]
    return x, theta_m + 0.05


OPERATING_POINTS = {
    "at rest in air": lambda: still(0.0, 0.02, -0.085),
    "pressing at home": lambda: still(0.0, 0.0, -0.105),
    "moving in sticking contact": sticking,
    "moving in air, off balance": moving_in_air,
}
"""Inside one piece of backlash, contact and friction: no kink within the steps of any difference."""


@given(moving())
def test_outputs_are_those_of_the_component_under_the_same_names(state):
    x, theta_m = state
    y = SYSTEM.output(0.0, x, theta_m)
    np.testing.assert_array_equal(y, Plant(PARAMETERS, x, theta_m).initial_outputs)
    assert SYSTEM.output_labels == signal_labels(OUTPUTS)
    assert y[SYSTEM.output_labels.index("F_ee_B_z")] == Plant(PARAMETERS, x, theta_m).initial("F_ee_B")[2]
    assert SYSTEM.input_labels == ["theta_m_1", "theta_m_2", "theta_m_3"]
    assert SYSTEM.state_labels == STATE_LABELS


@pytest.mark.parametrize("point", OPERATING_POINTS)
def test_linearisation_is_the_jacobian_of_the_equations(point):
    x, theta_m = OPERATING_POINTS[point]()

    def rate_and_outputs(z):
        return np.concatenate([SYSTEM.dynamics(0.0, z[:8], z[8:]), SYSTEM.output(0.0, z[:8], z[8:])])

    linear = control.linearize(SYSTEM, x, theta_m)
    found = np.block([[linear.A, linear.B], [linear.C, linear.D]])
    expected = jacobian_by_differences(rate_and_outputs, np.concatenate([x, theta_m]))
    # relative to the largest slope of each row: control's forward difference of 1e-6 m is wrong by half of that times
    # the curvature, 0.24 of 1e-4 was seen
    slope = np.abs(expected).max(axis=1, keepdims=True)
    assert np.all(np.abs(found - expected) <= 1e-4 * slope)


def test_free_modes_at_home_are_those_of_springs_and_mass():
    parameters = PARAMETERS._replace(K=0.0, b_j=0.0)
    x, theta_m = resting(parameters, (0.0, 0.0, -0.105))
    A = control.linearize(plant_system(parameters), x, theta_m).A
    modes = np.sort(np.abs(np.linalg.eigvals(A[:6, :6]).imag))[::2]
    # values of another computation, to the digits given
    np.testing.assert_allclose(modes, [75.39, 75.39, 101.30], rtol=0, atol=0.006)


def test_one_constant_can_be_replaced_for_one_call():
    x, theta_m = resting(PARAMETERS, (0.0, 0.0, -0.090))
    stiffer = PARAMETERS._replace(k_s=2.0)
    expected = plant_system(stiffer).dynamics(0.0, x, theta_m)
    np.testing.assert_array_equal(SYSTEM.dynamics(0.0, x, theta_m, params={"k_s": 2.0}), expected)
    assert np.abs(expected - SYSTEM.dynamics(0.0, x, theta_m)).max() > 0.1


def test_out_of_reach_nothing_is_a_number():
    x, theta_m = resting(PARAMETERS, (0.0, 0.0, -0.105))
    x[2] = -0.2
    assert np.isnan(SYSTEM.dynamics(0.0, x, theta_m)[3:6]).all()
