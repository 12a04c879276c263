"""The electronic scale under the robot: it shows the vertical force in steps."""

import numpy as np

from twin.cosim.component import NativeComponent
from twin.cosim.native import step_function
from twin.cosim.port import Port, memory_of, record
from twin.settings import Settings, setting


class Display(Settings):
    """[scale]: the electronic scale's display."""

    resolution: float = setting("g", gt=0, help="smallest step of the display")
    period: float = setting("ms", gt=0, help="time between two readings")


INPUTS = (Port("F_ee_B", 3, "N", "force by the robot on the scale in base frame B"),)
OUTPUTS = (Port("F_z", 1, "N", "reading of the scale, pressing positive"),)
MEMORY = record(resolution="f8")


@step_function(MEMORY, INPUTS, OUTPUTS)
def step(m, t, h, u, y):
    y.F_z = np.floor(-u.F_ee_B[2] / m.resolution + 0.5) * m.resolution
    return 0


class Scale(NativeComponent):
    """Reads the true contact force, rounded to the nearest step of `resolution` (N), every `period` ticks."""

    def __init__(self, resolution: float, period: int = 1):
        super().__init__("scale", INPUTS, OUTPUTS, True, step, memory_of(MEMORY, resolution=resolution), period=period)
