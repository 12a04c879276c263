"""The co-simulation component alone follows the differential equation that python-control sees."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tests.laws.runs import PARAMETERS, ComponentStepper
from twin.robot.plant.component import NO_MOTION, Plant, rest_state, settle
from twin.robot.plant.contact import apex_frame
from twin.studies.analyse.linear.hand import plant_system

TICK = 1e-3
TICKS = 120
# the bristle's rate jumps whenever friction sticks or slips; 5e-10 m of it is 2e-6 N
ATOL = np.array([1e-12] * 6 + [5e-10] * 2)
POSITION_AND_BRISTLE, VELOCITY = [0, 1, 2, 6, 7], [3, 4, 5]


def held_motor_angles(theta_m):
    """Motor angles held over each tick that press, sweep sideways and turn back, shape (TICKS, 3)."""
    t = np.arange(TICKS) * TICK
    press = 0.15 * (1.0 - np.cos(2.0 * np.pi * 2.0 * t))
    sweep = 0.10 * np.sin(2.0 * np.pi * 4.0 * t)
    return theta_m + np.stack([press + sweep, press, press - sweep], axis=-1)


def component_states(parameters, x, theta_m, inputs, substeps):
    plant = Plant(parameters, x, theta_m, substeps)
    stepped = ComponentStepper(plant)
    y = np.array([stepped(u, 0.0, TICK) for u in inputs])
    return np.concatenate([y[:, :6], y[:, 22:24]], axis=1)


def integrated_states(parameters, x, inputs):
    """The same with scipy; the bristle is settled after each tick, the component settles it after each substep."""
    system = plant_system(parameters)
    states = []
    for u in inputs:

        def rate(_t, x, u=u):
            return system.dynamics(0.0, x, u)

        # at those jumps steps are tried in vain, and one of order 8 costs twice as much
        solution = solve_ivp(rate, (0.0, TICK), x, method="RK45", first_step=TICK, rtol=1e-10, atol=ATOL)
        x = solution.y[:, -1]
        settle(parameters, apex_frame(parameters), x, NO_MOTION, NO_MOTION)
        states.append(x)
    return np.array(states)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("parameters", "height", "substeps"),
    [
        pytest.param(PARAMETERS, -0.085, 100, id="air"),
        pytest.param(PARAMETERS._replace(mu=0.0), -0.103, 100, id="frictionless contact"),
        pytest.param(PARAMETERS, -0.1015, 500, id="friction that sticks, slips and turns"),
    ],
)
def test_component_steps_the_differential_equation_of_the_python_control_system(parameters, height, substeps):
    x, theta_m = rest_state(parameters, (0.0, 0.01, height))
    inputs = held_motor_angles(theta_m)
    stepped = component_states(parameters, x, theta_m, inputs, substeps)
    expected = integrated_states(parameters, x, inputs)
    assert np.ptp(expected[:, 2]) > 1e-3
    # metres; what is left is the order-one error of substeps across a slip and a turn of the friction
    np.testing.assert_allclose(stepped[:, POSITION_AND_BRISTLE], expected[:, POSITION_AND_BRISTLE], rtol=0, atol=1e-8)
    # m/s at up to 100 rad/s, and 4e-6 N of friction on 0.2 kg over a tick or two
    np.testing.assert_allclose(stepped[:, VELOCITY], expected[:, VELOCITY], rtol=0, atol=1e-6)


def test_one_runge_kutta_step_per_tick_is_enough_for_the_task():
    x, theta_m = rest_state(PARAMETERS, (0.0, 0.01, -0.1015))
    inputs = held_motor_angles(theta_m)
    coarse = component_states(PARAMETERS, x, theta_m, inputs, 1)
    fine = component_states(PARAMETERS, x, theta_m, inputs, 100)
    # 4 um of 1250 N/m are 0.005 N: this motion is twenty times faster than the sweep of Fig. 4
    np.testing.assert_allclose(coarse[:, POSITION_AND_BRISTLE], fine[:, POSITION_AND_BRISTLE], rtol=0, atol=4e-6)
