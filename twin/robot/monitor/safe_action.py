"""Safe action of the monitor: raise the platform away from the person, hold it, and cut the power of disobeying motors.

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
from twin.kernel.settings import fields_of_form
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import joint_angles, position
from twin.robot.monitor.checks import MAX_COUNT
from twin.robot.monitor.reasons import Reason

RETREAT_STEPS = 101

_FLAG_FIELDS = "power power_off_tick brake blind"
_ENCODER_FIELDS = {**fields_of_form("3i8", "doubt_m doubt_l"), **fields_of_form("3f8", "travel_m travel_l")}
RETRACTION_RECORD = record(
    **states(
        **fields_of_form("3i8", "unfollowed off"),
        **fields_of_form("3f8", "most least"),
        **fields_of_form("i8", _FLAG_FIELDS),
        **_ENCODER_FIELDS,
    )
)
"""State of a retraction. Per joint: ticks off the retraction's command, whether its power is cut, upper and lower bound
of its recent commands (rad/s); whether any drive has power; tick of the first loss of power, -1 before; whether brakes
may close; ticks without a valid encoder message; per drive whether the motor and the joint encoder are doubted, and the
angle of the motor and, on the motor's side, of the joint since the trip (rad), positive downwards."""
SINK_LIMIT = math.radians(3.0)
"""Maximum angle (rad) of a motor below its angle at the trip, in addition to the remaining travel of the slowest
obeying drive: less than 4 N on a rigid body. The limit above the end of its retraction is equal."""
DOUBT_SHARE = 0.5
"""Minimum share of a frozen encoder's limit for doubting further encoders after a trip; also the minimum share of
`jump_limit` for two samples in the same direction to count as a motion."""
FOLLOW_SLACK = 0.25
"""Permitted lag of a retracting motor behind the slowest obeying drive, as a share of `follow_limit`: above the ripple
of its low-passed speed, 0.33 rad/s."""


@njit(cache=True)
def retraction_speed(limits, retraction, since):
    """Return the commanded speed (rad/s) of every powered motor during the retraction, `since` (s) after the trip."""
    turning = retraction.power == 1 and since < (limits.retract - 1e-9) / limits.retract_speed
    return -limits.retract_speed if turning else 0.0


@njit(cache=True)
def keeps_moving(limits, seen, i):
    """Check whether the motor encoder of drive `i` moved fast, and in the same direction, in the last two samples.

    A wrong count jumps once, or there and back; a runaway drive keeps moving. DOUBT_SHARE leaves room for a count more
    or less of a motion at `jump_limit`.
    """
    fast = min(abs(seen.last_m[i]), abs(seen.rate_m[i])) >= DOUBT_SHARE * limits.jump_limit
    return fast and (seen.last_m[i] > 0.0) == (seen.rate_m[i] > 0.0)


@njit(cache=True)
def mark_doubtful_encoders(limits, seen, timers, retraction, reason, count_m, count_l, ticks, tick):
    """Mark encoders as doubtful after a trip: those named by its `reason`, and any that later jumps or is unusable.

    A deflection and a hidden force doubt the joint encoders alone: the motor encoders still show whether drives obey. A
    motor encoder that keeps moving is trusted again: its drive moves.

    Args:
        reason: reason of the trip in its tick; 0 later.
        count_m, count_l: encoder message (3,).
        ticks: ticks since the previous message; 0 without a new one.
        tick: duration of a tick (s).
    """
    for i in range(3):
        m, l = abs(seen.rate_m[i]), abs(seen.rate_l[i])
        jumped = ticks > 0 and seen.fastest[i] >= limits.jump_limit
        still = tick * abs(timers.still[i]) >= DOUBT_SHARE * limits.frozen_time
        stuck = abs(seen.theta_m[i] - timers.anchor[i]) >= DOUBT_SHARE * limits.frozen_travel
        deflected = abs(seen.deflection[i]) >= limits.deflection_limit
        if ticks > 0 and keeps_moving(limits, seen, i):
            retraction.doubt_m[i] = 0
        # not >=: that would let NaN pass
        elif (
            not abs(count_m[i]) < MAX_COUNT
            or (reason == Reason.FROZEN_MOTOR and still)
            or (jumped and m >= min(l, limits.jump_limit))
        ):
            retraction.doubt_m[i] = 1
        if (
            not abs(count_l[i]) < MAX_COUNT
            or reason in (Reason.NO_POSE, Reason.HIDDEN_FORCE)
            or (reason == Reason.DEFLECTION and deflected)
            or (reason == Reason.FROZEN_JOINT and stuck)
            or (jumped and l >= min(m, limits.jump_limit))
        ):
            retraction.doubt_l[i] = 1


@njit(cache=True)
def add_travel(limits, seen, retraction, dt):
    """Add the travel of motor and joint angles since the trip, `dt` (s) after the previous sample; jumps are
    ignored."""
    for i in range(3):
        if abs(seen.rate_m[i]) < limits.jump_limit or keeps_moving(limits, seen, i):
            retraction.travel_m[i] += dt * seen.rate_m[i]
        if abs(seen.rate_l[i]) < limits.jump_limit:
            retraction.travel_l[i] += dt * seen.rate_l[i]


@njit(cache=True)
def update_command_bounds(limits, retraction, sent, dt):
    """Update the upper and lower bound of the recent commands `sent` (3,), rad/s, which decay with the time constant
    `obey_lag`.

    A first-order drive of a lag up to `obey_lag` stays between them: at the bound, where omega_m = most, it has
    d omega_m/dt = (omega_ref - omega_m)/T <= (omega_ref - most)/obey_lag = d most/dt.
    """
    share = 1.0 - math.exp(-dt / limits.obey_lag)
    for i in range(3):
        retraction.most[i] = max(sent[i], retraction.most[i] + share * (sent[i] - retraction.most[i]))
        retraction.least[i] = min(sent[i], retraction.least[i] + share * (sent[i] - retraction.least[i]))


@njit(cache=True)
def is_too_fast(limits, seen, retraction, i, retracting):
    """Check whether drive `i` exceeds the bounds of its recent commands, either way, by more than `follow_limit`.

    With a doubted motor encoder the joint is judged, only downwards and only after the retraction: it swings as fast as
    the retraction.
    """
    speed, most, least = seen.omega_m[i], retraction.most[i], min(retraction.least[i], -limits.retract_speed)
    if retraction.doubt_m[i]:
        return not retracting and seen.omega_l[i] >= max(most, limits.retract_speed) + limits.follow_limit
    return speed >= most + limits.follow_limit or speed <= least - limits.follow_limit


@njit(cache=True)
def is_too_late(limits, seen, retraction, i, since):
    """Check whether drive `i` retracts later than the slowest obeying drive, `since` (s) after the trip.

    The joint is judged, too, unless it is doubted; with a doubted motor encoder the joint alone.
    """
    left = math.exp(-max(0.0, since - limits.obey_delay) / limits.obey_lag)
    slowest = (retraction.most[i] + limits.retract_speed) * left - limits.retract_speed
    if retraction.doubt_m[i]:
        return seen.omega_l[i] >= max(0.0, slowest) + limits.follow_limit
    late = seen.omega_m[i] if retraction.doubt_l[i] else min(seen.omega_m[i], seen.omega_l[i])
    return late >= slowest + FOLLOW_SLACK * limits.follow_limit


@njit(cache=True)
def is_too_far(limits, retraction, i):
    """Check whether the angle of drive `i` is more than `SINK_LIMIT` beyond any obeying drive, downwards or upwards.

    The slowest obeying drive travels on after the trip. The joint is judged if the motor encoder is doubted, or has not
    moved since the trip; only downwards, because it swings upwards.
    """
    unmoved = retraction.doubt_m[i] or retraction.travel_m[i] == 0.0
    if unmoved and retraction.doubt_l[i]:
        return False
    most, back = max(0.0, retraction.most[i]), limits.retract_speed
    # integral of the speed in `is_too_late` down to 0
    coasting = most * (limits.obey_delay + limits.obey_lag) - back * limits.obey_lag * math.log(1.0 + most / back)
    up = limits.retract - min(0.0, retraction.least[i]) * (limits.obey_delay + limits.obey_lag)
    if unmoved:
        return retraction.travel_l[i] >= SINK_LIMIT + coasting
    return retraction.travel_m[i] >= SINK_LIMIT + coasting or retraction.travel_m[i] <= -SINK_LIMIT - up


@njit(cache=True)
def presses_at_limit(limits, seen, retraction):
    """Check whether force or depth are at their limits, by encoders that are not doubted."""
    doubted_m, doubted_l = retraction.doubt_m.sum() > 0, retraction.doubt_l.sum() > 0
    deep, strong = seen.depth >= limits.penetration_limit, seen.force >= limits.force_limit
    return not doubted_l and (deep or (strong and not doubted_m))


@njit(cache=True)
def cut_power(retraction, i, lines, now):
    """Cut the power of drive `i`, or of all drives if they have no lines of their own."""
    for j in range(3):
        if j == i or not lines:
            retraction.off[j] = 1
    if retraction.power_off_tick < 0:
        retraction.power_off_tick = now
    if retraction.off[0] and retraction.off[1] and retraction.off[2]:
        retraction.power = 0


@njit(cache=True)
def enforce(limits, seen, retraction, lines, now, since, age, unseen):
    """Cut the power of drives that disobey the retraction, or move too fast or too far, `since` (s) after the trip.

    Drives without a sound encoder lose their power at the end of the retraction. Once all drives are at rest, force or
    depth at a limit cut all.

    Args:
        lines: whether each drive has a power line of its own.
        now: current tick.
        age: age of the encoder message (s).
        unseen: whether encoder messages are missing.
    """
    if limits.disobeyed == 0 or retraction.power == 0:
        return
    retracting = retraction_speed(limits, retraction, since) != 0.0
    for i in range(3):
        if unseen or (retraction.doubt_m[i] and retraction.doubt_l[i]):
            failed = not retracting
        else:
            failed = is_too_far(limits, retraction, i) or is_too_fast(limits, seen, retraction, i, retracting)
            failed = failed or (retracting and is_too_late(limits, seen, retraction, i, since - age))
        if failed and retraction.off[i] == 0:
            cut_power(retraction, i, lines, now)
    if not unseen and is_retraction_over(limits, since) and presses_at_limit(limits, seen, retraction):
        cut_power(retraction, 0, False, now)


@njit(cache=True)
def is_retraction_over(limits, since):
    """Check whether the slowest obeying drive has stopped, within `FOLLOW_SLACK`, `since` (s) after the trip."""
    ended = since - limits.retract / limits.retract_speed - limits.obey_delay
    return limits.retract_speed * math.exp(-max(0.0, ended) / limits.obey_lag) <= FOLLOW_SLACK * limits.follow_limit


@njit(cache=True)
def follow_tolerance(limits, since):
    """Return the maximum deviation (rad/s) of a motor from its command during a retraction, `since` (s) after the trip;
    smaller at the end."""
    return (
        FOLLOW_SLACK * limits.follow_limit
        if limits.disobeyed and is_retraction_over(limits, since)
        else limits.follow_limit
    )


@njit(cache=True)
def supervise(limits, seen, retraction, lines, ticks, tick, now, since):
    """Cut the power of drives that deviate from the retraction for `follow_time`.

    A joint is at fault only if both its motor and its joint encoder deviate: a turning motor moves its joint, so one of
    the two encoders may be wrong. A doubted joint encoder is ignored; if both are doubted, the joint is not judged.

    Args:
        ticks: ticks since the previous valid encoder message.
        tick: duration of a tick (s).
        lines, now, since: see `enforce`.
    """
    limit = follow_tolerance(limits, since)
    for i in range(3):
        error_m = abs(seen.omega_cmd[i] - seen.omega_m[i])
        error_l = abs(seen.omega_cmd[i] - seen.omega_l[i])
        if limits.disobeyed and retraction.doubt_l[i]:
            error_l = 0.0 if retraction.doubt_m[i] else error_m
        astray = min(error_m, error_l) >= limit
        retraction.unfollowed[i] = retraction.unfollowed[i] + ticks if astray else 0
        if retraction.unfollowed[i] * tick >= limits.follow_time * (1.0 - 1e-9) and retraction.off[i] == 0:
            cut_power(retraction, i, lines, now)


@njit(cache=True)
def close_brakes(limits, seen, retraction, tick, now):
    """Close the brakes once they hold no force, or have been open for `release_time`."""
    if retraction.power_off_tick >= 0 and retraction.brake == 0:
        waited = tick * (now - retraction.power_off_tick)
        if seen.force < 0.5 * limits.contact_force or waited >= limits.release_time:
            retraction.brake = 1


class Retreat(NamedTuple):
    """Effect of the monitor's retraction on the platform: its rise and horizontal displacement (m).

    `slowest` is the lowest rise per motor angle along the path (m/rad); negative where the platform would sink.
    """

    raised: float
    sideways: float
    slowest: float


def retreat(geometry: Geometry, N: float, p_B: ArrayLike, retract: float) -> Retreat:
    """Compute the rise and sideways motion of the platform for a retraction by `retract` (rad, each motor) from `p_B`
    (3,), m, in free air.

    Forward kinematics (Eq. 13-17) along the path of equally falling theta_l = theta_m / N on all legs. A pressing
    robot rises less, by the travel of its unwinding springs: the force over their stiffness J^T k_s N^2 eta J.

    Raises:
        Unreachable: the path leaves the workspace.
    """
    theta_m = np.linspace(0.0, retract, RETREAT_STEPS)
    path = position(geometry, joint_angles(geometry, p_B) - theta_m[:, None] / N)
    raised, sideways = path[-1, 2] - path[0, 2], np.hypot(*(path[-1, :2] - path[0, :2]))
    return Retreat(float(raised), float(sideways), float(np.min(np.diff(path[:, 2]) / np.diff(theta_m))))
