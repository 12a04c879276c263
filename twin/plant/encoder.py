"""The encoders: angles become counts, and that is all a controller ever gets."""

from collections.abc import Sequence

import numpy as np
from numba import carray

from twin.cosim.component import NativeComponent, Port
from twin.cosim.native import step_function

INPUTS = (Port("theta_m", 3, "rad", "motor angles"), Port("theta_l", 3, "rad", "proximal link angles"))
OUTPUTS = (
    Port("count_m", 3, "1", "motor encoder counts", "int"),
    Port("count_l", 3, "1", "joint encoder counts", "int"),
)
MEMORY = np.dtype([("counts_per_rad", "f8", (6,)), ("zero", "f8", (6,))], align=True)


@step_function(MEMORY)
def step(self, t, h, u, y):
    m = carray(self, 1)[0]
    angle, count = carray(u, 6), carray(y, 6)
    for i in range(6):
        count[i] = np.floor((angle[i] + m.zero[i]) * m.counts_per_rad[i] + 0.5)
    return 0


class Encoder(NativeComponent):
    """Motor and joint encoders of the three legs; counts are rounded to the nearest.

    Args:
        motor_counts, joint_counts: counts per turn.
        motor_zero, joint_zero: zero errors (3,), rad, added to the true angle.
        period: ticks between samples.
    """

    def __init__(
        self,
        motor_counts: float,
        joint_counts: float,
        motor_zero: Sequence[float] = (0.0, 0.0, 0.0),
        joint_zero: Sequence[float] = (0.0, 0.0, 0.0),
        period: int = 1,
    ):
        memory = np.zeros(1, dtype=MEMORY)
        memory["counts_per_rad"] = np.repeat([motor_counts, joint_counts], 3) / (2 * np.pi)
        memory["zero"] = [*motor_zero, *joint_zero]
        super().__init__("encoder", INPUTS, OUTPUTS, True, step, memory, period=period)
