"""What the robot's computer and its safety monitor believe, each of the robot for itself."""

from typing import Any

from twin.controller.belief import Belief
from twin.experiment import schema
from twin.experiment.experiment import Experiment
from twin.experiment.monitor import Monitor
from twin.experiment.robot import Model
from twin.monitor.belief import MonitorBelief
from twin.monitor.limits import Limits
from twin.robot.geometry import Geometry


def geometry_of(model: Model) -> Geometry:
    """Fig. 2 as `model` has it."""
    return Geometry(model.a, model.b, model.l_a, model.l_b)


def belief(experiment: Experiment) -> Belief:
    """What the controller believes."""
    return believed(experiment.controller)


def believed(computer: schema.Controller) -> Belief:
    """[controller.model] and the dead zone as the estimator takes them."""
    m = computer.model
    return Belief(
        a=m.a, b=m.b, l_a=m.l_a, l_b=m.l_b, m_a=m.m_a, m_b=m.m_b, m_p=m.m_p, k_s=m.k_s, N=m.N, eta=m.eta,
        motor_counts=m.motor_counts_per_turn, joint_counts=m.joint_counts_per_turn,
        motor_zero=m.motor_zero, joint_zero=m.joint_zero, backlash=computer.dead_zone,
    )  # fmt: skip


def monitor_belief(robot: Any) -> MonitorBelief:
    """What the safety monitor believes: the robot as [robot] has it, whatever [controller.model] says."""
    return MonitorBelief(**{name: getattr(robot, _NAMES.get(name, name)) for name in MonitorBelief._fields})


_NAMES = {"motor_counts": "motor_counts_per_turn", "joint_counts": "joint_counts_per_turn"}


def monitor_limits(monitor: Monitor, speed_limit: float) -> Limits:
    """The limits of [monitor] as the component takes them; `speed_limit`: of the controller's commands (rad/s)."""
    given = {name: getattr(monitor, name) for name in Limits._fields}
    return Limits(**{**given, "command_limit": monitor.command_limit or speed_limit})
