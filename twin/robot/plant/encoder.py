"""Measurements of the plant, the only inputs of a controller: encoder counts and the display of the scale.

White noise comes from a generator whose whole state is one word in a component's memory: same seed, same bytes.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.component import NativeComponent, step_function
from twin.kernel.cosim.port import Port, memory_of, record, state
from twin.kernel.settings import Settings, setting

# Steele, Lea and Flood (2014), Fast splittable pseudorandom number generators, OOPSLA; the constants of splitmix64
_STRIDE = np.uint64(0x9E3779B97F4A7C15)
_MIX_1, _MIX_2 = np.uint64(0xBF58476D1CE4E5B9), np.uint64(0x94D049BB133111EB)
_30, _27, _31, _11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
ENCODER_INPUTS = (Port("theta_m", 3, "rad", "motor angles"), Port("theta_l", 3, "rad", "proximal link angles"))
ENCODER_OUTPUTS = (
    Port("count_m", 3, "1", "motor encoder counts", "int"),
    Port("count_l", 3, "1", "joint encoder counts", "int"),
    Port("sample", 1, "1", "number of the sample, from 1: a reader notices lost and frozen messages by it", "int"),
)
READER_RECORD = record(counts_per_rad="f8", zero="f8", noise="f8", eccentricity="f8", eccentric_at="f8")
ENCODER_MEMORY = record(
    motor=(READER_RECORD, (3,)), joint=(READER_RECORD, (3,)), random=state(("u8", (1,))), sample=state("i8")
)
MAX_COUNT = 2.0**53
"""Bound of the counts: beyond it, a double does not represent every integer."""
UNCOUNTED_STATUS = 2
"""Step status for an angle without a count."""
SCALE_INPUTS = (Port("F_ee_B", 3, "N", "force by the robot on the scale in base frame B"),)
SCALE_OUTPUTS = (Port("F_z", 1, "N", "reading of the scale, pressing positive"),)
SCALE_MEMORY = record(resolution="f8")


@njit(cache=True)
def random_word(state):
    """Advance the splitmix64 generator in `state`, (1,) uint64, and return its next 64 bits."""
    state[0] += _STRIDE
    word = state[0]
    word = (word ^ (word >> _30)) * _MIX_1
    word = (word ^ (word >> _27)) * _MIX_2
    return word ^ (word >> _31)


@njit(cache=True)
def uniform(state):
    """Return a random number in (0, 1] with 53 random bits."""
    return float((random_word(state) >> _11) + np.uint64(1)) * 2.0**-53


@njit(cache=True)
def normal(state):
    """Return a normally distributed number with mean 0 and variance 1: Box and Muller (1958), Ann Math Stat 29:610."""
    radius = math.sqrt(-2.0 * math.log(uniform(state)))
    return radius * math.cos(2.0 * math.pi * uniform(state))


@njit(cache=True)
def count(angle, reader, random):
    """Return an encoder's whole counts at the shaft's angle (rad), noise from `random`; NaN if not representable."""
    read = angle + reader.zero
    if reader.eccentricity != 0.0:
        read += reader.eccentricity * math.sin(angle - reader.eccentric_at)
    if reader.noise > 0.0:
        read += reader.noise * normal(random)
    counts = read * reader.counts_per_rad + 0.5
    # not >=, which would accept NaN; converting an unrepresentable integer differs between processors
    return float(math.floor(counts)) if abs(counts) < MAX_COUNT else math.nan


@step_function(ENCODER_MEMORY, ENCODER_INPUTS, ENCODER_OUTPUTS)
def step(m, t, h, u, y):
    # motors first, as this order determines the noise
    for i in range(3):
        y.count_m[i] = count(u.theta_m[i], m.motor[i], m.random)
    for i in range(3):
        y.count_l[i] = count(u.theta_l[i], m.joint[i], m.random)
    m.sample += 1
    y.sample = m.sample
    for i in range(3):
        if math.isnan(y.count_m[i]) or math.isnan(y.count_l[i]):
            return UNCOUNTED_STATUS
    return 0


class Shaft(NamedTuple):
    """Properties of the encoders of three shafts of one kind (motors or joints).

    Attributes:
        counts: counts per turn.
        zero: errors (3,), rad, added to the true angle.
        noise: standard deviation of white noise on the angle before it is rounded, rad.
        eccentricity, eccentric_at: error e sin(angle - at) of a disc or magnet off its shaft's axis (3,), rad.
    """

    counts: float
    zero: Sequence[float] = (0.0, 0.0, 0.0)
    noise: float = 0.0
    eccentricity: Sequence[float] = (0.0, 0.0, 0.0)
    eccentric_at: Sequence[float] = (0.0, 0.0, 0.0)

    def error(self, angles: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the errors of the encoders at `angles` (3,), rad, before noise and rounding."""
        return np.array(self.zero) + np.array(self.eccentricity) * np.sin(angles - np.array(self.eccentric_at))

    def readers(self) -> list[tuple[float, ...]]:
        """Return the properties of each encoder as a record of `READER_RECORD`."""
        each = zip(self.zero, self.eccentricity, self.eccentric_at, strict=True)
        return [(self.counts / (2 * np.pi), zero, self.noise, e, at) for zero, e, at in each]


class Encoder(NativeComponent):
    """Sampled component of the motor and joint encoders of the three legs; counts are rounded to the nearest.

    Args:
        motor, joint: properties of the encoders.
        period: ticks between samples.
        seed: seed of the noise; equal seeds give equal noise.
    """

    def __init__(self, motor: Shaft, joint: Shaft, period: int = 1, seed: int = 0):
        memory = memory_of(ENCODER_MEMORY, motor=motor.readers(), joint=joint.readers(), random=seed)
        super().__init__("encoder", ENCODER_INPUTS, ENCODER_OUTPUTS, True, step, memory, period=period)

    def explain(self, status: int) -> str:
        return "got an angle that it cannot count (NaN, infinite or beyond 2^53 counts)"


class Display(Settings):
    """[scale]: the electronic scale's display."""

    resolution: float = setting("g", gt=0, help="smallest step of the display")
    period: float = setting("ms", gt=0, help="time between two readings")


@step_function(SCALE_MEMORY, SCALE_INPUTS, SCALE_OUTPUTS)
def scale_step(m, t, h, u, y):
    y.F_z = np.floor(-u.F_ee_B[2] / m.resolution + 0.5) * m.resolution
    return 0


class Scale(NativeComponent):
    """Sampled component of the electronic scale: true contact force, rounded to steps of `resolution` (N)."""

    def __init__(self, resolution: float, period: int = 1):
        super().__init__(
            "scale",
            SCALE_INPUTS,
            SCALE_OUTPUTS,
            True,
            scale_step,
            memory_of(SCALE_MEMORY, resolution=resolution),
            period=period,
        )
