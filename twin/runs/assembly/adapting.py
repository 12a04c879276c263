"""What the controller does besides the paper's law, from an experiment: its beliefs of tissue, gains and breath."""

import math

import numpy as np
from numpy.typing import NDArray

from twin.controller.adaptive import Adapting
from twin.controller.breath import Breathing
from twin.controller.schedule import SchedulePoint, Scheduling
from twin.controller.tissue import Sensing
from twin.experiment.experiment import Experiment
from twin.experiment.robot import Model, Triple
from twin.experiment.schema import Controller
from twin.robot.gravity import Masses, leg_inertia, moving_mass
from twin.robot.inverse_kinematics import joint_angles
from twin.robot.jacobian import jacobian
from twin.runs.assembly.beliefs import geometry_of

ENOUGH, DOUBTFUL = 0.4, 0.7
"""Shares of the tolerance at which the dither ends, and begins anew: before the estimate is no longer trusted."""
LIGHT_TOUCH = 0.3
"""Pressing force (N) below which nothing is learnt of the tissue."""


def adapting(experiment: Experiment) -> Adapting | None:
    """What of it the experiment asks for; None: nothing."""
    c = experiment.controller
    if c.tissue is None:
        return None
    scheduling = None
    if c.force.schedule:
        scheduling = Scheduling(c.tissue.tolerance, c.force.rate, c.force.follow, c.force.kp, c.force.ki)
    points = [SchedulePoint(point.stiffness, point.kp, point.ki) for point in c.force.schedule]
    breathing = None if c.breath is None else Breathing(c.breath.rate, c.breath.lag)
    learning = 0.0 if c.touch is None else c.touch.force_learning
    return Adapting(sensing(c, experiment.start), scheduling, points, breathing, learning)


def sensing(computer: Controller, p_B: Triple) -> Sensing:
    """How the tissue is looked at, with the robot as it is believed to be at `p_B` (m)."""
    tissue, model = computer.tissue, computer.model
    assert tissue is not None
    J = jacobian(geometry_of(model), p_B)
    theta_l = joint_angles(geometry_of(model), p_B)
    j = J[:, 2]
    squares = float(j @ j)
    spring = model.k_s * model.eta * model.N**2 * squares
    # rounding to whole counts is off by an even distribution
    motor, joint = (2.0 * math.pi / counts / math.sqrt(12.0) for counts in _counts(model))
    to_force = model.k_s * model.eta * model.N * math.sqrt(squares)
    return Sensing(
        tissue.frequency,
        tissue.window,
        tissue.dither,
        ENOUGH * tissue.tolerance,
        DOUBTFUL * tissue.tolerance,
        LIGHT_TOUCH,
        _mass(model, j, np.asarray(theta_l)),
        spring,
        joint / math.sqrt(squares),
        to_force * math.hypot(motor, model.N * joint),
    )


def _counts(model: Model) -> tuple[int, int]:
    return model.motor_counts_per_turn, model.joint_counts_per_turn


def _mass(model: Model, j: NDArray[np.float64], theta_l: NDArray[np.float64]) -> float:
    """What moves up and down with the platform (kg): M_zz of the believed robot, whose pulleys have no inertia."""
    masses = Masses(model.m_a, model.m_b, model.m_p, 0.0)
    # dA_i/dtheta is l_a cos(theta) downwards
    arms = leg_inertia(geometry_of(model), masses) * j - model.m_b / 3.0 * model.l_a * np.cos(theta_l)
    return float(moving_mass(masses) + arms @ j)
