"""The encoders: angles become counts, and that is all a controller ever gets."""

import math
from collections.abc import Sequence

import numpy as np
from numba import carray

from twin.cosim.component import NativeComponent, Port
from twin.cosim.native import step_function
from twin.plant.noise import normal

INPUTS = (Port("theta_m", 3, "rad", "motor angles"), Port("theta_l", 3, "rad", "proximal link angles"))
OUTPUTS = (
    Port("count_m", 3, "1", "motor encoder counts", "int"),
    Port("count_l", 3, "1", "joint encoder counts", "int"),
    Port("sample", 1, "1", "number of the sample, from 1: a reader notices lost and frozen messages by it", "int"),
)
MEMORY = np.dtype(
    [
        ("counts_per_rad", "f8", (6,)),
        ("zero", "f8", (6,)),
        ("noise", "f8", (6,)),
        ("random", "u8", (1,)),
        ("sample", "i8"),
    ],
    align=True,
)


@step_function(MEMORY)
def step(self, t, h, u, y):
    m = carray(self, 1)[0]
    angle, y = carray(u, 6), carray(y, 7)
    for i in range(6):
        read = angle[i] + m.zero[i]
        if m.noise[i] > 0.0:
            read += m.noise[i] * normal(m.random)
        y[i] = math.floor(read * m.counts_per_rad[i] + 0.5)
    m.sample += 1
    y[6] = m.sample
    return 0


class Encoder(NativeComponent):
    """Motor and joint encoders of the three legs; counts are rounded to the nearest.

    Args:
        motor_counts, joint_counts: counts per turn.
        motor_zero, joint_zero: zero errors (3,), rad, added to the true angle.
        period: ticks between samples.
        motor_noise, joint_noise: standard deviation of white noise on the angle before it is rounded, rad.
        seed: of the noise; the same seed gives the same noise.
    """

    def __init__(
        self,
        motor_counts: float,
        joint_counts: float,
        motor_zero: Sequence[float] = (0.0, 0.0, 0.0),
        joint_zero: Sequence[float] = (0.0, 0.0, 0.0),
        period: int = 1,
        motor_noise: float = 0.0,
        joint_noise: float = 0.0,
        seed: int = 0,
    ):
        memory = np.zeros(1, dtype=MEMORY)
        memory["counts_per_rad"] = np.repeat([motor_counts, joint_counts], 3) / (2 * np.pi)
        memory["zero"] = [*motor_zero, *joint_zero]
        memory["noise"] = np.repeat([motor_noise, joint_noise], 3)
        memory["random"] = seed
        super().__init__("encoder", INPUTS, OUTPUTS, True, step, memory, period=period)
