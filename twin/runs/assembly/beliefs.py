"""What the robot's computer and its safety monitor believe, each of the robot for itself."""

from twin.controller.belief import Belief
from twin.controller.computer import Computer
from twin.experiment.experiment import Experiment
from twin.monitor.belief import MonitorBelief
from twin.monitor.limits import Limits, Monitor
from twin.plant.parameters import Robot
from twin.robot.geometry import Geometry
from twin.robot.model import Model


def geometry_of(model: Model) -> Geometry:
    """Fig. 2 as `model` has it."""
    return Geometry(model.a, model.b, model.l_a, model.l_b)


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
