"""The electronic scale under the robot: it shows the vertical force in steps."""

import numpy as np
from numba import carray

from twin.cosim.component import NativeComponent, Port
from twin.cosim.native import step_function

INPUTS = (Port("F_ee_B", 3, "N", "force by the robot on the scale in base frame B"),)
OUTPUTS = (Port("F_z", 1, "N", "reading of the scale, pressing positive"),)
MEMORY = np.dtype([("resolution", "f8")], align=True)


@step_function(MEMORY)
def step(self, t, h, u, y):
    m = carray(self, 1)[0]
    carray(y, 1)[0] = np.floor(-carray(u, 3)[2] / m.resolution + 0.5) * m.resolution
    return 0


class Scale(NativeComponent):
    """Reads the true contact force, rounded to the nearest step of `resolution` (N), every `period` ticks."""

    def __init__(self, resolution: float, period: int = 1):
        memory = np.array([(resolution,)], dtype=MEMORY)
        super().__init__("scale", INPUTS, OUTPUTS, True, step, memory, period=period)
