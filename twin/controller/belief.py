"""What the controller believes of the robot: its own model, not the plant's parameters."""

from twin.controller.processor import Processor
from twin.cosim.port import record_of
from twin.robot.model import Model
from twin.settings import FieldSource, Values, taken


class Belief(
    Values,
    parts=(
        taken(Model),
        {name: FieldSource(Model, name, broken_by=(f"belief_{name}",)) for name in ("k_s", "eta")},
        taken(Model, into="encoders"),
        taken(Processor, "dead_zone"),
    ),
):
    """The controller's model, SI: [controller.model], and as `backlash` the half width of the springs' dead zone.

    That is on the motor's side; 0: the paper's estimator, blind to it.
    """


BELIEF = record_of(Belief)
