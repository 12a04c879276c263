"""The monitor's safe action: raise the platform away from the person, then hold it; cut motors that do not obey.

All motors turn at the same speed -retract_speed for a set time. Positive theta lowers the platform (Eq. 5), so this
raises it: the height changes by the sum of the third row of J^-1 times the joints' speed, and that sum is positive
everywhere in the workspace (docs/safety.md has the numbers). No encoder takes part, because a wrong encoder may be the
reason for the trip.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.port import record, states
from twin.kernel.settings import alike
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import joint_angles, position
from twin.robot.monitor.checks import FROZEN_JOINT

STEPS = 101

_FLAGS = "power power_off_tick brake blind"
RETRACTION = record(**states(**alike("3i8", "unfollowed off"), **alike("3f8", "most least"), **alike("i8", _FLAGS)))
"""Ticks for which each joint has not followed the retraction; whether its drive's power is cut; the most and the least
that it was commanded of late (rad/s); whether any drive has power; the tick at which one lost it, -1: none; whether
brakes may close; ticks without a valid encoder message."""
SLACK = 0.25
"""Share of `follow_limit` by which a retracting motor may be slower than the slowest drive that obeys: above the ripple
of its low-passed speed, 0.33 rad/s."""
DOUBTED = FROZEN_JOINT
"""Reasons up to this one doubt encoders: then no speed that they tell is taken for disobedience."""


@njit(cache=True)
def retraction_speed(limits, retraction, since):
    """Speed (rad/s) of every motor that has power, `since` (s) the trip."""
    turning = retraction.power == 1 and since < (limits.retract - 1e-9) / limits.retract_speed
    return -limits.retract_speed if turning else 0.0


@njit(cache=True)
def remember(limits, retraction, sent, dt):
    """Keep the most and the least of what is `sent` to the drives (3,), rad/s, forgotten with `obey_lag`.

    A first-order drive of a lag up to `obey_lag` stays between them: at the bound, where omega_m = most, it has
    d omega_m/dt = (omega_ref - omega_m)/T <= (omega_ref - most)/obey_lag = d most/dt.
    """
    share = 1.0 - math.exp(-dt / limits.obey_lag)
    for i in range(3):
        retraction.most[i] = max(sent[i], retraction.most[i] + share * (sent[i] - retraction.most[i]))
        retraction.least[i] = min(sent[i], retraction.least[i] + share * (sent[i] - retraction.least[i]))


@njit(cache=True)
def disobeys(limits, seen, retraction, i, since):
    """Whether drive `i`, `since` (s) the trip, does what no drive does that obeys.

    It turns faster than anything that it was commanded of late, either way, by `follow_limit`; or it is later in
    turning back than the slowest drive that obeys, by its joint, too: one of the two encoders may be the failure.
    """
    speed, least = seen.omega_m[i], min(retraction.least[i], -limits.retract_speed)
    if speed >= retraction.most[i] + limits.follow_limit or speed <= least - limits.follow_limit:
        return True
    left = math.exp(-max(0.0, since - limits.obey_delay) / limits.obey_lag)
    slowest = (retraction.most[i] + limits.retract_speed) * left - limits.retract_speed
    return min(speed, seen.omega_l[i]) >= slowest + SLACK * limits.follow_limit


@njit(cache=True)
def cut(retraction, i, lines, now):
    """Take the power of drive `i`; of all, where they have no lines of their own."""
    for j in range(3):
        if j == i or not lines:
            retraction.off[j] = 1
    if retraction.power_off_tick < 0:
        retraction.power_off_tick = now
    if retraction.off[0] and retraction.off[1] and retraction.off[2]:
        retraction.power = 0


@njit(cache=True)
def enforce(limits, seen, retraction, reason, lines, now, since, unseen):
    """Cut at once the drives that do not obey the retraction, `since` (s) the trip.

    All of them, once it is over by `follow_time` and no encoder message has said that it was done.

    Args:
        reason: of the trip.
        lines: whether each drive has a line of power of its own.
        now: in ticks.
        unseen: whether no encoder message says what the motors do.
    """
    if limits.disobeyed == 0 or retraction.power == 0:
        return
    if unseen and since >= limits.retract / limits.retract_speed + limits.follow_time:
        cut(retraction, 0, False, now)
    if unseen or reason <= DOUBTED or retraction_speed(limits, retraction, since) == 0.0:
        return
    for i in range(3):
        if retraction.off[i] == 0 and disobeys(limits, seen, retraction, i, since):
            cut(retraction, i, lines, now)


@njit(cache=True)
def tolerated(limits, since):
    """Speed (rad/s) by which a motor may be off its command, `since` (s) the trip: less once all of them stand still.

    That is when the slowest drive that obeys the end of the retraction has come down to what is tolerated then.
    """
    if limits.disobeyed == 0:
        return limits.follow_limit
    ended = since - limits.retract / limits.retract_speed - limits.obey_delay
    still = limits.retract_speed * math.exp(-max(0.0, ended) / limits.obey_lag) <= SLACK * limits.follow_limit
    return SLACK * limits.follow_limit if still else limits.follow_limit


@njit(cache=True)
def supervise(limits, seen, retraction, lines, ticks, tick, now, since):
    """Take the power if a joint does not do what the retraction commands for `follow_time`.

    Only a joint whose motor and joint encoder both deny it is at fault: a motor that turns moves its joint, so one of
    the two encoders may be the failure.

    Args:
        lines: whether each drive has a line of power of its own.
        ticks: since the last valid encoder message, without which no limit is judged.
        tick: in s.
        now: in ticks.
        since: the trip, in s.
    """
    limit = tolerated(limits, since)
    for i in range(3):
        error_m = abs(seen.omega_cmd[i] - seen.omega_m[i])
        error_l = abs(seen.omega_cmd[i] - seen.omega_l[i])
        astray = min(error_m, error_l) >= limit
        retraction.unfollowed[i] = retraction.unfollowed[i] + ticks if astray else 0
        if retraction.unfollowed[i] * tick >= limits.follow_time * (1.0 - 1e-9) and retraction.off[i] == 0:
            cut(retraction, i, lines, now)


@njit(cache=True)
def release(limits, seen, retraction, tick, now):
    """Let brakes close once no force is left for them to hold, or they have been open for `release_time`."""
    if retraction.power_off_tick >= 0 and retraction.brake == 0:
        waited = tick * (now - retraction.power_off_tick)
        if seen.force < 0.5 * limits.contact_force or waited >= limits.release_time:
            retraction.brake = 1


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
