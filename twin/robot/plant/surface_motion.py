"""Motion of the body under the robot: breathing and shifts, as displacement and velocity of its surface.

With tau the time since onset:

    breathing   s = A (1 - cos(2 pi f tau)): A is the amplitude, so a breath lifts the surface by 2 A. It starts and
                ends between two breaths, where displacement and velocity are 0; a breath in progress at `end` is
                completed.
    shift       s = D m(tau / rise), back again from `end` on; m(q) = 10 q^3 - 15 q^4 + 6 q^5 is the path of least jerk
                (Flash and Hogan 1985, J Neurosci 5:1688) and keeps the acceleration continuous, too.
"""

import math
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from twin.kernel.compiled.function import carray, njit, pointer_to
from twin.kernel.cosim.component import NativeComponent, step_function
from twin.kernel.cosim.port import Port, record, record_of
from twin.kernel.settings import Settings, Triple, numbers, optional, setting

BODY_OUTPUTS = (
    Port("s_B", 3, "m", "displacement of the surface in base frame B"),
    Port("v_s_B", 3, "m/s", "velocity of the surface in base frame B"),
)
BODY_MEMORY = record(motions="i8", count="i8")
"""Address and number of the motions."""


class MotionKind(IntEnum):
    """Kind of a motion of the body's surface."""

    BREATHING = 0
    SHIFT = 1


class Motion(NamedTuple):
    """One motion of the body's surface, SI.

    Attributes:
        displacement: vector in B (m): amplitude of breathing, total displacement of a shift.
        onset, end: start, and end or return (s); infinity for never.
        rate: frequency of breathing (Hz), > 0.
        rise: duration of a shift (s), > 0.
    """

    kind: MotionKind
    displacement: Triple
    onset: float
    end: float = math.inf
    rate: float = 0.25
    rise: float = 1.0


class Breathing(Settings):
    """[contact.breathing]: the surface rises by twice the amplitude and falls with every breath."""

    amplitude: float = setting(
        "mm", field="displacement", ge=0, examples=[1.0], help="half of the height by which a breath lifts the surface"
    )
    rate: float = setting("1/min", gt=0, examples=[15.0], help="breaths per minute")
    start: float = setting("s", field="onset", default=0.0, ge=0, help="beginning of the first breath")
    end: float | None = optional(
        "s", absent=math.inf, ge=0, example=20.0, help="time in the last breath; without it, no end"
    )

    @property
    def motion(self) -> Motion:
        """Breathing as a surface motion along z."""
        return Motion(**(numbers(self) | {"kind": MotionKind.BREATHING, "displacement": (0.0, 0.0, self.amplitude)}))


class Shift(Settings):
    """[contact.shift]: the person moves once, and back again if an end is given."""

    by: Triple = setting("mm", field="displacement", examples=[[0.0, 0.0, 2.0]], help="shift of the surface (x, y, z)")
    start: float = setting("s", field="onset", ge=0, examples=[5.0], help="start of the motion")
    rise: float = setting("s", gt=0, examples=[0.5], help="duration of the motion")
    end: float | None = optional(
        "s", absent=math.inf, ge=0, example=20.0, help="start of the return; without it, no return"
    )

    @property
    def motion(self) -> Motion:
        """Shift of the body as a surface motion."""
        return Motion(MotionKind.SHIFT, **numbers(self))


MOTION_RECORD = record_of(Motion)
_motions_at = pointer_to(MOTION_RECORD)


# NumPy division: a rate or rise of 0 must give NaN, because an exception is lost in compiled code that the master calls
# by address
@njit(cache=True, error_model="numpy")
def breathing(motion, t):
    """Return the displacement by breathing at `t` (s), as a share of the amplitude, and its rate of change (1/s)."""
    last = motion.onset + np.ceil((motion.end - motion.onset) * motion.rate) / motion.rate
    if t <= motion.onset or t >= last:
        return 0.0, 0.0
    omega = 2.0 * math.pi * motion.rate
    phase = omega * (t - motion.onset)
    return 1.0 - math.cos(phase), omega * math.sin(phase)


@njit(cache=True, error_model="numpy")
def least_jerk(t, rise):
    """Return the completed share of a shift of duration `rise` (s), `t` seconds after its start, and its rate (1/s)."""
    if t <= 0.0:
        return 0.0, 0.0
    if t >= rise:
        return 1.0, 0.0
    q = t / rise
    return q * q * q * (10.0 + q * (6.0 * q - 15.0)), 30.0 * q * q * (1.0 - q) * (1.0 - q) / rise


@njit(cache=True)
def progress(motion, t):
    """Return the share of its displacement that a surface motion has reached at `t` (s), and its rate (1/s)."""
    if motion.kind == MotionKind.BREATHING:
        return breathing(motion, t)
    there, v_there = least_jerk(t - motion.onset, motion.rise)
    back, v_back = least_jerk(t - motion.end, motion.rise)
    return there - back, v_there - v_back


@step_function(BODY_MEMORY, outputs=BODY_OUTPUTS)
def step(m, t, h, u, y):
    motions = carray(_motions_at(m.motions), m.count)
    y.s_B[:] = 0.0
    y.v_s_B[:] = 0.0
    for i in range(m.count):
        motion = motions[i]
        share, rate = progress(motion, t)
        for axis in range(3):
            y.s_B[axis] += share * motion.displacement[axis]
            y.v_s_B[axis] += rate * motion.displacement[axis]
    return 0


class Body(NativeComponent):
    """Sampled component of the body under the robot: the sum of its surface motions, every tick."""

    def __init__(self, motions: Sequence[Motion]):
        table = np.array([tuple(motion) for motion in motions], dtype=MOTION_RECORD)
        memory = np.array([(0, len(table))], dtype=BODY_MEMORY)
        super().__init__("body", (), BODY_OUTPUTS, True, step, memory, pointers={"motions": table})
