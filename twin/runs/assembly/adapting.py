"""What the controller does besides the paper's law, from an experiment: its beliefs of tissue, gains and breath."""

import math

import numpy as np

from twin.controller.adaptive import Adapting
from twin.controller.computer import Computer
from twin.controller.schedule import SchedulePoint, Scheduling
from twin.controller.tissue import Sensing
from twin.experiment.experiment import Experiment
from twin.robot.gravity import Masses, leg_inertia, moving_mass
from twin.robot.inverse_kinematics import joint_angles
from twin.robot.jacobian import jacobian
from twin.runs.assembly.beliefs import geometry_of
from twin.settings import Triple

LIGHT_TOUCH = 0.3
"""Pressing force (N) below which nothing is learnt of the tissue."""


def adapting(experiment: Experiment) -> Adapting | None:
    """What of it the experiment asks for; None: nothing."""
    c = experiment.controller
    if c.tissue is None:
        return None
    scheduling = None
    if c.force.schedule:
        scheduling = Scheduling.made(c.tissue, c.force)
    points = [SchedulePoint.made(point) for point in c.force.schedule]
    learning = 0.0 if c.touch is None else c.touch.force_learning
    return Adapting(sensing(c, experiment.start), scheduling, points, c.breath, learning)


def sensing(computer: Computer, p_B: Triple) -> Sensing:
    """How the tissue is looked at, with the robot as it is believed to be, about `p_B` (m)."""
    tissue, model = computer.tissue, computer.model
    assert tissue is not None
    geometry, masses = geometry_of(model), Masses(model.m_a, model.m_b, model.m_p, 0.0)
    # the rods' part of M_zz that is of first order in J_z changes by grams within reach; dA_i/dtheta is l_a cos(theta)
    downwards = model.l_a * np.cos(joint_angles(geometry, p_B))
    rods = -model.m_b / 3.0 * float(downwards @ jacobian(geometry, p_B)[:, 2])
    # rounding to whole counts is off by an even distribution
    counts = model.motor_counts_per_turn, model.joint_counts_per_turn
    motor, joint = (2.0 * math.pi / each / math.sqrt(12.0) for each in counts)
    per_motor = model.k_s * model.eta * model.N
    return Sensing.made(
        tissue,
        contact=LIGHT_TOUCH,
        mass=float(moving_mass(masses)) + rods,
        inertia=float(leg_inertia(geometry, masses)),
        joint_spring=per_motor * model.N,
        angle_rounding=joint,
        torque_rounding=per_motor * math.hypot(motor, model.N * joint),
    )
