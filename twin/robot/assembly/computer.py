"""The robot's computer: estimator, controller and safety monitor.

What the robot's computer and its safety monitor believe, each of the robot for itself.

What the controller does besides the paper's law, from an experiment: its beliefs of tissue, gains and breath.
"""

import math
from collections.abc import Sequence

import numpy as np

from twin.kernel.cosim.delay import delay
from twin.kernel.errors import InputRefused
from twin.kernel.settings import Triple
from twin.robot.assembly.build import Build, Makers
from twin.robot.controller import program as programs
from twin.robot.controller.adaptive import Adapting, SchedulePoint, Scheduling
from twin.robot.controller.controller import (
    NEVER,
    OMEGA_REF,
    P_REF_B,
    Belief,
    Controller,
    Estimator,
    Law,
    WayPointReference,
)
from twin.robot.controller.energy_tank import Tank, TankValve
from twin.robot.controller.pid import Believed, Gains, force_gains
from twin.robot.controller.program import Phase
from twin.robot.controller.task_controller import Computer, TaskController
from twin.robot.controller.tissue import Sensing
from twin.robot.experiment.experiment import Experiment
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.mechanism.kinematics import jacobian, joint_angles
from twin.robot.mechanism.statics import Masses, leg_inertia, moving_mass
from twin.robot.monitor.checks import Limits, Monitor
from twin.robot.monitor.component import POWER, SafetyMonitor
from twin.robot.monitor.observation import MonitorBelief
from twin.robot.plant.dynamics import Robot


def belief(experiment: Experiment) -> Belief:
    """What the controller believes."""
    return believed(experiment.controller)


def believed(computer: Computer) -> Belief:
    """[controller.model] and the dead zone as the estimator takes them."""
    return Belief.made(computer, computer.model)


def monitor_belief(robot: Robot) -> MonitorBelief:
    """What the safety monitor believes: the robot as [robot] has it, whatever [controller.model] says."""
    return MonitorBelief.made(robot, backlash=robot.backlash)


def monitor_limits(monitor: Monitor, speed_limit: float) -> Limits:
    """The limits of [monitor] as the component takes them; `speed_limit`: of the controller's commands (rad/s)."""
    return Limits.made(monitor, command_limit=monitor.command_limit or speed_limit)


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


LATE = 1.5
"""Periods of the controller after which a message of the encoders is late."""


def estimator(experiment: Experiment) -> Estimator:
    """Encoder counts to position and force."""
    return Estimator(belief(experiment), experiment.controller.gravity_compensation, experiment.controller_ticks)


def controller(experiment: Experiment, program: Sequence[Phase] | None = None) -> Controller | TaskController:
    """The force-position law with the experiment's gains, led by way points or by tasks.

    In position mode nothing ever triggers the force loop.

    Args:
        program: phases that lead it instead of those of the experiment's tasks; only if it has tasks.
    """
    c = experiment.controller
    force_on = c.mode == "force_position"
    # in position mode nothing starts the force loop
    started = {} if force_on else {"trigger_force": NEVER, "trigger_time": NEVER}
    law = Law.made(c, c.model, c.force, **started)
    position, force = Gains.made(c.position), force_gains(c.force)
    ticks, besides, tank = experiment.controller_ticks, adapting(experiment), c.energy_tank is not None
    if experiment.reference is not None and program is None:
        return Controller(law, position, force, experiment.reference.t, experiment.reference.p, ticks, besides, tank)
    if program is None:
        assert experiment.approach is not None and c.touch is not None
        program = programs.program(experiment.approach, c.touch.contact, experiment.tasks)
    assert c.touch is not None and c.feed_forward is not None and c.damping is not None
    return TaskController(
        law,
        position,
        force,
        Believed.made(c.model, c.feed_forward),
        c.damping,
        c.touch,
        program,
        experiment.start,
        ticks,
        besides,
        tank,
    )


def estimators(build: Build) -> Makers:
    """What makes the estimator."""
    return {"estimator": lambda: estimator(build.experiment)}


def controllers(build: Build) -> Makers:
    """What makes the controller."""
    return {"controller": lambda: controller(build.experiment)}


def references(build: Build) -> Makers:
    """What makes the pre-defined way, if a third-party controller has an input for it.

    Raises:
        InputRefused: there is none.
    """
    other = build.others.get("controller")
    if other is None or P_REF_B not in other.inputs:
        return {}
    reference, ticks = build.experiment.reference, build.experiment.controller_ticks
    if reference is None:
        raise InputRefused(f"{other.label}: takes p_ref_B, and tasks have no waypoints; it needs a [reference]")
    return {"reference": lambda: WayPointReference(reference.t, reference.p, ticks)}


def tanks(build: Build) -> Makers:
    """What makes the energy tank behind the controller, if it has one."""
    c, ticks = build.experiment.controller, build.experiment.controller_ticks
    if c.energy_tank is None:
        return {}
    tank = Tank.made(c.energy_tank, c.model, late=LATE * ticks * build.experiment.cosim.tick)
    return {"tank": lambda: TankValve(tank, ticks)}


def delays(build: Build) -> Makers:
    """What makes the delay of the computation behind the controller, if one is set."""
    ticks = build.experiment.controller.delay_ticks
    return {"delay": lambda: delay("delay", (OMEGA_REF,), ticks, np.zeros(OMEGA_REF.size))} if ticks else {}


def monitors(build: Build) -> Makers:
    """What makes the safety monitor, if anybody watches."""
    experiment = build.experiment
    if experiment.monitor is None:
        return {}
    limits = monitor_limits(experiment.monitor, experiment.controller.speed_limit)
    periods = experiment.controller_ticks, experiment.monitor_ticks
    return {"monitor": lambda: SafetyMonitor(monitor_belief(experiment.robot), limits, *periods)}


def buses(build: Build) -> Makers:
    """What makes the bus between the last of the computer and the drives, if it takes time.

    Until the first message has come the drives are commanded to stand still, and have power.
    """
    ticks = build.experiment.controller.bus_delay_ticks
    if not ticks:
        return {}
    ports = (OMEGA_REF,) if build.experiment.monitor is None else (OMEGA_REF, POWER)
    initial = np.concatenate([np.zeros(OMEGA_REF.size), np.ones(len(ports) - 1)])
    return {"bus": lambda: delay("bus", ports, ticks, initial)}
