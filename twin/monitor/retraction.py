"""The safe action: raise the platform away from the person, then hold it; cut the power if the motors do not obey.

All motors turn at the same speed -retract_speed for a set time. Positive theta lowers the platform (Eq. 5), so this
raises it: the height changes by the sum of the third row of J^-1 times the joints' speed, and that sum is positive
everywhere in the workspace (docs/safety.md has the numbers). No encoder takes part, because a wrong encoder may be the
reason for the trip.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twin.compiled.function import njit
from twin.cosim.port import record
from twin.robot.forward_kinematics import position
from twin.robot.geometry import Geometry
from twin.robot.inverse_kinematics import joint_angles

STEPS = 101

RETRACTION = record(unfollowed="3i8", power="i8", power_off_tick="i8")
"""Ticks for which each joint has not followed the retraction; power; the tick at which it went off, -1: never."""


@njit(cache=True)
def retraction_speed(limits, retraction, since):
    """Speed (rad/s) of every motor, `since` (s) the trip."""
    turning = retraction.power == 1 and since < (limits.retract - 1e-9) / limits.retract_speed
    return -limits.retract_speed if turning else 0.0


@njit(cache=True)
def supervise(limits, seen, retraction, ticks, tick, now):
    """Take the power if a joint does not do what the retraction commands for `follow_time`.

    Only a joint whose motor and joint encoder both deny it is at fault: a motor that turns moves its joint, so one of
    the two encoders may be the failure.

    Args:
        ticks: since the last valid encoder message, without which nobody is accused.
        tick: in s.
        now: in ticks.
    """
    for i in range(3):
        error_m = abs(seen.omega_cmd[i] - seen.omega_m[i])
        error_l = abs(seen.omega_cmd[i] - seen.omega_l[i])
        astray = min(error_m, error_l) >= limits.follow_limit
        retraction.unfollowed[i] = retraction.unfollowed[i] + ticks if astray else 0
        if retraction.unfollowed[i] * tick >= limits.follow_time * (1.0 - 1e-9) and retraction.power == 1:
            retraction.power = 0
            retraction.power_off_tick = now


class Retreat(NamedTuple):
    """What a retraction does to the platform.

    Attributes:
        raised: how much higher it ends (m).
        sideways: how far it moves horizontally (m).
        slowest: lowest rise per motor angle on the way (m/rad); negative where it would sink.
    """

    raised: float
    sideways: float
    slowest: float


def retreat(geometry: Geometry, N: float, p_B: ArrayLike, retract: float) -> Retreat:
    """Where a retraction by `retract` (rad, each motor) takes a robot in free air that stands at `p_B` (3,), m.

    Forward kinematics (Eq. 13-17) along the path on which theta_l = theta_m / N falls equally on all legs. A robot that
    presses rises less, by what its springs unwind: the force over their stiffness J^T k_s N^2 eta J.

    Raises:
        Unreachable: the path leaves the workspace.
        InputRefused: p_B is not finite or not of shape (3,).
    """
    theta_m = np.linspace(0.0, retract, STEPS)
    path = position(geometry, joint_angles(geometry, p_B) - theta_m[:, None] / N)
    raised, sideways = path[-1, 2] - path[0, 2], np.hypot(*(path[-1, :2] - path[0, :2]))
    return Retreat(float(raised), float(sideways), float(np.min(np.diff(path[:, 2]) / np.diff(theta_m))))
