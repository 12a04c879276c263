import math

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.laws.runs import PARAMETERS, ComponentStepper, shipped
from twin.robot.assembly.build import belief
from twin.robot.controller.compliance import Damping
from twin.robot.controller.controller import Controller, Estimator, Law
from twin.robot.controller.pid import Gains
from twin.robot.mechanism.geometry import NO_ANCHOR, Geometry
from twin.robot.mechanism.kinematics import joint_angles
from twin.robot.plant.component import NO_MOTION, integrate, rest_state
from twin.robot.plant.contact import apex_frame
from twin.studies.analyse.linear.hand import linear_plant
from twin.studies.analyse.linear.loops import (
    LAW_STATES,
    DriveModel,
    LinearLaw,
    LoopSettings,
    LoopStepping,
    estimation,
    linear_law,
    period_map,
    runge_kutta_step,
    tick_map,
)

PERIOD = 2e-3
POSITION, FORCE, CORNER = Gains(4.0, 3.0, 0.02, 30.0), Gains(2e-3, 5e-3, 1e-5, 20.0), 10.0
BELIEF = belief(shipped())._replace(motor_counts=2.0**40, joint_counts=2.0**40)
X, THETA_M = rest_state(PARAMETERS, (0.005, 0.01, -0.105))
ANGLES = np.concatenate([THETA_M, joint_angles(Geometry(0.05, 0.03, 0.06, 0.1139), X[:3])])
F_REF = 5.0


def law(standing: np.ndarray, damping: Damping | None = None) -> LinearLaw:
    settings = LoopSettings(BELIEF.N, BELIEF.eta, POSITION, FORCE, CORNER, damping, PERIOD)
    return linear_law(settings, estimation(BELIEF, True, ANGLES, standing))


def real_commands(deviations: np.ndarray) -> np.ndarray:
    """omega_ref (n, 3) of the real estimator and controller for `ANGLES` + `deviations` (n, 6), reference at rest."""
    limits = Law(BELIEF.N, math.inf, F_REF, math.inf, 0.0, math.inf, CORNER)
    estimator = ComponentStepper(Estimator(BELIEF))
    controller = ComponentStepper(Controller(limits, POSITION, FORCE, [0.0], [X[:3].tolist()]))
    commands = []
    for angles in ANGLES + deviations:
        estimated = estimator.outputs_by_port(np.round(angles * 2.0**40 / (2.0 * np.pi)))
        given = np.concatenate([estimated[name] for name in ("p_B", "J", "F_ee_B")])
        commands.append(controller.outputs_by_port(given, h=PERIOD)["omega_ref"])
    return np.array(commands)


def linear_commands(deviations: np.ndarray) -> np.ndarray:
    """What the linear law makes of the same deviations, all its loops closed."""
    linear = law(np.zeros(3))
    state, commands = np.zeros(LAW_STATES), []
    for angles in deviations:
        back = np.zeros(4)
        # the position law depends on the force law's output, which depends on neither
        for _ in range(2):
            outputs = linear.C @ state + linear.D @ np.concatenate([angles, back, np.zeros(4)])
            back = outputs[3:7]
        inputs = np.concatenate([angles, back, np.zeros(4)])
        commands.append((linear.C @ state + linear.D @ inputs)[:3])
        state = linear.A @ state + linear.B @ inputs
    return np.array(commands)


def test_the_linear_law_commands_what_estimator_and_controller_do():
    deviations = 1e-6 * np.random.default_rng(0).normal(size=(300, 6))
    # until the force filter has filled
    deviations[:200] = 0.0
    found = real_commands(deviations) - real_commands(np.zeros_like(deviations))
    # the filling has left something in the force integral, on which the Jacobian turns
    np.testing.assert_allclose(linear_commands(deviations), found, atol=0.002 * np.abs(found).max())


def test_a_turning_jacobian_turns_the_steady_command():
    standing = np.array([0.05, 0.03, 0.04])
    turned = estimation(BELIEF, True, ANGLES, standing).turned
    along = 1e-4 * np.random.default_rng(0).normal(size=6)
    u = np.linalg.solve(BELIEF.N * estimation(BELIEF, True, ANGLES, standing).J, standing)
    there = BELIEF.N * estimation(BELIEF, True, ANGLES + along, standing).J @ u
    # the second derivative of the Jacobian, a thousandth over 1e-4 rad
    np.testing.assert_allclose(turned @ along, there - standing, rtol=0.01)


def test_motors_give_way_to_a_step_of_torque_and_forget_it():
    damping = Damping.model_construct(gain=10.0, corner=4.0)
    linear = law(np.zeros(3), damping)
    angles = np.zeros(6)
    angles[0] = 1e-3
    inputs = np.concatenate([angles, np.zeros(8)])
    state, given_way = np.zeros(LAW_STATES), []
    for _ in range(400):
        given_way.append((linear.C @ state + linear.D @ inputs)[0])
        state = linear.A @ state + linear.B @ inputs
    k = np.arange(1, 401)
    # a first-order high-pass of the spring's torque k_s theta_m, sampled
    expected = -10.0 * BELIEF.k_s * 1e-3 * np.exp(-2.0 * np.pi * 4.0 * PERIOD * k)
    # the estimator is differentiated to 1e-9
    np.testing.assert_allclose(given_way, expected, rtol=1e-6, atol=1e-9)


TICK = 1e-3
LAG = np.exp(-TICK / 0.02)
SERVO = DriveModel(np.array([[LAG]]), np.array([[1.0 - LAG, -0.6 * (1.0 - LAG)]]), np.array([[TICK]]), np.zeros((1, 2)))
"""A speed that lags behind command and load, and an angle that it moves."""


def plant(z: float) -> control.StateSpace:
    return linear_plant(PARAMETERS, *rest_state(PARAMETERS, (0.005, 0.01, z)))


@pytest.mark.slow
@pytest.mark.parametrize("substeps", [1, 3])
@pytest.mark.parametrize("z", [-0.09, -0.105], ids=["in air", "pressing"])
def test_the_step_of_the_linear_plant_is_the_derivative_of_the_component_s_own(substeps, z):
    x, theta_m = rest_state(PARAMETERS, (0.005, 0.01, z))
    linear = linear_plant(PARAMETERS, x, theta_m)
    A, B = runge_kutta_step(linear.A, linear.B, TICK, substeps)
    scratch = apex_frame(PARAMETERS), NO_ANCHOR

    def stepped(deviation):
        new = x.copy()
        new[:6] += deviation[:6]
        # the bristle follows the platform while it sticks
        new[6:] += deviation[:2] if z < PARAMETERS.z_s else 0.0
        for _ in range(substeps):
            integrate(
                PARAMETERS, new, theta_m + deviation[6:], NO_MOTION, NO_MOTION, NO_MOTION, TICK / substeps, *scratch
            )
        return new[:6]

    step = 1e-6
    found = np.stack([(stepped(step * e) - stepped(-step * e)) / (2.0 * step) for e in np.eye(9)], axis=1)
    # forward differences of 1e-6 behind A and B; the largest entries are near 40
    np.testing.assert_allclose(np.hstack([A, B]), found, atol=2e-3)


def test_in_jacobi_a_command_moves_the_platform_one_tick_later():
    commanded = np.array([1.0, 1.0, 1.0])
    first = []
    for jacobi in (False, True):
        step = tick_map(plant(-0.09), [SERVO] * 3, LoopStepping(TICK, 1, 1, 0, jacobi))
        x, seen = step.B @ commanded, []
        for _ in range(4):
            seen.append(abs((step.C @ x)[step.output_labels.index("p_B_z")]) > 0.0)
            x = step.A @ x
        first.append(seen.index(True))
    assert first[1] == first[0] + 1


@given(period=st.integers(1, 4), delay=st.integers(0, 9), seed=st.integers(0, 100))
def test_a_period_is_its_ticks_with_the_command_delayed_and_held(period, delay, seed):
    stepping = LoopStepping(TICK, 1, period, delay, False)
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
