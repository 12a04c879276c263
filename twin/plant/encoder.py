"""The encoders: angles become counts, and that is all a controller ever gets."""

import math
from collections.abc import Sequence

import numpy as np
from numba import njit

from twin.cosim.component import NativeComponent
from twin.cosim.native import step_function
from twin.cosim.port import Port
from twin.cosim.record import memory_of, record
from twin.plant.noise import normal

INPUTS = (Port("theta_m", 3, "rad", "motor angles"), Port("theta_l", 3, "rad", "proximal link angles"))
OUTPUTS = (
    Port("count_m", 3, "1", "motor encoder counts", "int"),
    Port("count_l", 3, "1", "joint encoder counts", "int"),
    Port("sample", 1, "1", "number of the sample, from 1: a reader notices lost and frozen messages by it", "int"),
)
READER = record(counts_per_rad="f8", zero="f8", noise="f8")
MEMORY = record(motor=(READER, (3,)), joint=(READER, (3,)), random=("u8", (1,)), sample="i8")


@njit(cache=True)
def count(angle, reader, random):
    """Whole counts that an encoder makes of its shaft's `angle` (rad); `random` is the state of the noise."""
    read = angle + reader.zero
    if reader.noise > 0.0:
        read += reader.noise * normal(random)
    return math.floor(read * reader.counts_per_rad + 0.5)


@step_function(MEMORY, INPUTS, OUTPUTS)
def step(m, t, h, u, y):
    # the motors first: that is the order in which the noise is drawn
    for i in range(3):
        y.count_m[i] = count(u.theta_m[i], m.motor[i], m.random)
    for i in range(3):
        y.count_l[i] = count(u.theta_l[i], m.joint[i], m.random)
    m.sample += 1
    y.sample = m.sample
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
        motor = [(motor_counts / (2 * np.pi), zero, motor_noise) for zero in motor_zero]
        joint = [(joint_counts / (2 * np.pi), zero, joint_noise) for zero in joint_zero]
        memory = memory_of(MEMORY, motor=motor, joint=joint, random=seed)
        super().__init__("encoder", INPUTS, OUTPUTS, True, step, memory, period=period)
