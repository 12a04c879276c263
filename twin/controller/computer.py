"""[controller]: all tables of the robot's computer."""

from twin.controller.breath import Breath
from twin.controller.energy_tank import EnergyTank
from twin.controller.loops import ForceLoop, PositionLoop
from twin.controller.pid import Damping, FeedForward
from twin.controller.processor import Processor
from twin.controller.task_controller import Touch
from twin.controller.tissue import Tissue
from twin.robot.model import Model


class Computer(Processor):
    """[controller]: the robot's computer. `touch`, `feed_forward` and `damping` belong to tasks."""

    position: PositionLoop
    force: ForceLoop
    touch: Touch | None = None
    feed_forward: FeedForward | None = None
    damping: Damping | None = None
    tissue: Tissue | None = None
    breath: Breath | None = None
    energy_tank: EnergyTank | None = None
    model: Model
