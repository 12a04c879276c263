"""Calibrations to identify: runs of the twin, and windows made up of statics alone."""

from functools import cache

import numpy as np
from numpy.typing import NDArray

from tests.studies.replay.logs import EXPERIMENTS, ran
from twin.kernel.recording.logs.log import Log
from twin.kernel.recording.logs.reader import recording_log
from twin.robot.assembly.load import load_experiment
from twin.robot.controller.controller import Belief
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import jacobian, joint_angles
from twin.robot.mechanism.statics import arm_gravity_torque, joint_torques, platform_weight
from twin.studies.identify.identification import Identification, identify_log
from twin.studies.identify.parameters import (
    BACKLASH,
    COMPLIANCE,
    DAMPING,
    FRICTION,
    HEIGHT,
    JOINT_ZERO,
    KAPPA,
    OFFSET,
    parameters,
    starts,
)
from twin.studies.identify.windows import Windows
from twin.studies.replay.model import model_of, recorded_model

STEP = 0.005 * 9.81
"""N, of the scale."""
PLANE = -0.101


@cache
def belief() -> Belief:
    """That of the massage robot."""
    return model_of(load_experiment(EXPERIMENTS / "calibration.toml")).belief


@cache
def run(name: str = "calibration", *settings: str) -> Log:
    """The log of a run of experiments/NAME.toml."""
    return recording_log(ran(name, *settings))


@cache
def identification(name: str = "calibration", *settings: str, height: float | None = None) -> Identification:
    """What `twin identify` makes of that run, taken for what its controller believes."""
    recording = ran(name, *settings)
    return identify_log(run(name, *settings), recorded_model(recording.metadata, recording.path), height)


def true_parameters() -> np.ndarray:
    """A robot that is not what it is taken for (17,)."""
    x = starts(parameters(belief(), PLANE))
    x[KAPPA] = 0.828
    x[OFFSET : OFFSET + 3] = np.radians([0.5, -0.3, 0.2])
    x[JOINT_ZERO : JOINT_ZERO + 3] = np.radians([0.1, -0.05, 0.08])
    x[BACKLASH], x[FRICTION], x[COMPLIANCE], x[DAMPING] = np.radians(0.1), 5e-3, 8e-4, 3.0
    x[HEIGHT] = -0.1012
    return x


def windows_of_statics(x: np.ndarray, rng: np.random.Generator, noise: float = 0.0, side_force: float = 0.2) -> Windows:
    """Air and presses over a grid, as a robot with parameters `x` reads them; built forwards, from force to encoder.

    Args:
        rng: of the side forces and the noise. noise: standard deviation of the motor's reading (rad), half of it common
            to all windows of a cluster. side_force: share of F by which friction may pull sideways.
    """
    robot = belief()
    geometry = Geometry(robot.a, robot.b, robot.l_a, robot.l_b)
    grid = [(0.015 * i, 0.015 * j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    F = np.tile(np.concatenate([np.zeros(6), np.linspace(0.5, 6.0, 6), np.linspace(6.0, 0.5, 6)]), len(grid))
    n = len(F)
    where = np.repeat(grid, n // len(grid), axis=0)
    down = np.where(np.arange(n) % 2 == 0, 4e-3, -4e-3)
    z = x[HEIGHT] - x[COMPLIANCE] * F / (1.0 + x[DAMPING] * down)
    z[F == 0.0] = np.tile(np.linspace(-0.085, -0.098, 6), len(grid))
    p_B = np.column_stack([where, z])
    theta_l, J = joint_angles(geometry, p_B), jacobian(geometry, p_B)
    speed: NDArray[np.float64] = -J[:, :, 2] * down[:, None]
    pulled = rng.uniform(-side_force, side_force, (n, 2)) * F[:, None]
    load = np.column_stack([pulled, platform_weight(robot) - F])
    arms = np.vectorize(lambda theta: arm_gravity_torque(robot, robot, theta))(theta_l)
    tau = joint_torques(geometry, p_B, load) - arms + x[FRICTION] * speed
    d = tau / (x[KAPPA] * robot.N)
    joint: NDArray[np.float64] = theta_l + x[JOINT_ZERO : JOINT_ZERO + 3]
    motor: NDArray[np.float64] = d + np.sign(d) * x[BACKLASH] + robot.N * joint + x[OFFSET : OFFSET + 3]
    cluster = np.arange(n) // 6
    rate = np.where(F > 0.0, down / x[COMPLIANCE], 0.0)
    motor += noise * np.sqrt(0.5) * (rng.normal(size=(n, 3)) + rng.normal(size=(n // 6, 3))[cluster])
    t = 0.1 * np.arange(n, dtype=np.float64)
    return Windows(t, motor, joint, speed, np.zeros((n, 3)), np.full((n, 3), 1e-3), F, rate, F, F, cluster, 0.1)
