"""What the monitor believes of the robot: its own record, so that the controller's wrong model is not also its own."""

from twin.cosim.port import record_of
from twin.robot.model import Model
from twin.settings import Values, setting, taken


class MonitorBelief(
    Values,
    parts=(
        taken(Model),
        {"backlash": setting("rad", help="half width of the dead zone of the spring deflection, motor side")},
        taken(Model, into="encoders"),
    ),
):
    """The monitor's model of the robot, SI."""


BELIEF = record_of(MonitorBelief)
