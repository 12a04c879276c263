import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.laws.runs import PARAMETERS
from twin.plant.component import STILL, integrate
from twin.plant.equilibrium import resting
from twin.plant.surface import apex_frame
from twin.robot.leg import NO_ANCHOR
from twin.studies.analyse.linear.drive_model import DriveModel
from twin.studies.analyse.linear.plant_system import linear_plant
from twin.studies.analyse.linear.sampled_robot import Stepping, period_map, runge_kutta_step, tick_map

TICK = 1e-3
LAG = np.exp(-TICK / 0.02)
SERVO = DriveModel(np.array([[LAG]]), np.array([[1.0 - LAG, -0.6 * (1.0 - LAG)]]), np.array([[TICK]]), np.zeros((1, 2)))
"""A speed that lags behind command and load, and an angle that it moves."""


def plant(z: float) -> control.StateSpace:
    return linear_plant(PARAMETERS, *resting(PARAMETERS, (0.005, 0.01, z)))


@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize("z", [-0.09, -0.105], ids=["in air", "pressing"])
def test_the_step_of_the_linear_plant_is_the_derivative_of_the_component_s_own(substeps, z):
    x, theta_m = resting(PARAMETERS, (0.005, 0.01, z))
    linear = linear_plant(PARAMETERS, x, theta_m)
    A, B = runge_kutta_step(linear.A, linear.B, TICK, substeps)
    scratch = apex_frame(PARAMETERS), NO_ANCHOR

    def stepped(deviation):
        new = x.copy()
        new[:6] += deviation[:6]
        # the bristle follows the platform while it sticks
        new[6:] += deviation[:2] if z < PARAMETERS.z_s else 0.0
        for _ in range(substeps):
            integrate(PARAMETERS, new, theta_m + deviation[6:], STILL, STILL, STILL, TICK / substeps, *scratch)
        return new[:6]

    step = 1e-6
    found = np.stack([(stepped(step * e) - stepped(-step * e)) / (2.0 * step) for e in np.eye(9)], axis=1)
    # forward differences of 1e-6 behind A and B; the largest entries are near 40
    np.testing.assert_allclose(np.hstack([A, B]), found, atol=2e-3)


def test_in_jacobi_a_command_moves_the_platform_one_tick_later():
    commanded = np.array([1.0, 1.0, 1.0])
    first = []
    for jacobi in (False, True):
        step = tick_map(plant(-0.09), [SERVO] * 3, Stepping(TICK, 1, 1, 0, jacobi))
        x, seen = step.B @ commanded, []
        for _ in range(4):
            seen.append(abs((step.C @ x)[step.output_labels.index("p_B_z")]) > 0.0)
            x = step.A @ x
        first.append(seen.index(True))
    assert first[1] == first[0] + 1


@given(period=st.integers(1, 4), delay=st.integers(0, 9), seed=st.integers(0, 100))
def test_a_period_is_its_ticks_with_the_command_delayed_and_held(period, delay, seed):
    stepping = Stepping(TICK, 1, period, delay, False)
    tick = tick_map(plant(-0.105), [SERVO] * 3, stepping)
    robot = period_map(tick, stepping)
    commands = np.random.default_rng(seed).normal(size=(8, 3))
    x, s = np.zeros(robot.nstates), np.zeros(tick.nstates)
    for j, command in enumerate(commands):
        # what was commanded before the first call was nothing
        for k in range(j * period, (j + 1) * period):
            s = tick.A @ s + (tick.B @ commands[(k - delay) // period] if k >= delay else 0.0)
        x = robot.A @ x + robot.B @ command
        # the same products in another order
        np.testing.assert_allclose(robot.C @ x, tick.C @ s, rtol=1e-9, atol=1e-12)
