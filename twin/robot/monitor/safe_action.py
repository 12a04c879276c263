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
from twin.kernel.settings import fields_of_form
from twin.robot.mechanism.geometry import Geometry
from twin.robot.mechanism.kinematics import joint_angles, position
from twin.robot.monitor.checks import MAX_COUNT
from twin.robot.monitor.reasons import DEFLECTION, FROZEN_JOINT, FROZEN_MOTOR, HIDDEN_FORCE, NO_POSE

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
"""Ticks for which each joint has not followed the retraction; whether its drive's power is cut; the most and the least
that it was commanded of late (rad/s); whether any drive has power; the tick at which one lost it, -1: none; whether
brakes may close; ticks without a valid encoder message; whether the motor and the joint encoder of each drive are
doubted; angle of the motor and, on the motor's side, of the joint since the trip (rad), positive downwards."""
SINK_LIMIT = math.radians(3.0)
"""Largest angle (rad) of a motor below that at the trip, beyond what the slowest drive that obeys still travels down:
less than 4 N on a rigid body. The same above the end of its retraction."""
DOUBT_SHARE = 0.5
"""Share of the limit of a frozen encoder from which another one is doubted, too, once one of them trips; and of
`jump_limit`, from which two samples in the same direction are a motion."""
FOLLOW_SLACK = 0.25
"""Share of `follow_limit` by which a retracting motor may be slower than the slowest drive that obeys: above the ripple
of its low-passed speed, 0.33 rad/s."""


@njit(cache=True)
def retraction_speed(limits, retraction, since):
    """Speed (rad/s) of every motor that has power, `since` (s) the trip."""
    turning = retraction.power == 1 and since < (limits.retract - 1e-9) / limits.retract_speed
    return -limits.retract_speed if turning else 0.0


@njit(cache=True)
def keeps_moving(limits, seen, i):
    """Whether the motor encoder of drive `i` moved fast, and the same way, in the last two samples.

    A wrong count jumps once, or there and back; a drive that runs away goes on. At HALF, since one count more or less
    takes a motion at `jump_limit` below it.
    """
    fast = min(abs(seen.last_m[i]), abs(seen.rate_m[i])) >= DOUBT_SHARE * limits.jump_limit
    return fast and (seen.last_m[i] > 0.0) == (seen.rate_m[i] > 0.0)


@njit(cache=True)
def mark_doubtful_encoders(limits, seen, timers, retraction, reason, count_m, count_l, ticks, tick):
    """Mark the encoders that are doubted: those of the trip's `reason`, and each that later jumps or is unusable.

    A deflection and a hidden force doubt the joint encoders alone: the motors' own still tell whether drives obey. A
    motor encoder that runs on is believed again: its drive moves.

    Args:
        reason: of the trip, in its tick; later 0.
        count_m, count_l: of the encoder message (3,).
        ticks: since the message before; 0: no new one.
        tick: in s.
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
            or (reason == FROZEN_MOTOR and still)
            or (jumped and m >= min(l, limits.jump_limit))
        ):
            retraction.doubt_m[i] = 1
        if (
            not abs(count_l[i]) < MAX_COUNT
            or reason in (NO_POSE, HIDDEN_FORCE)
            or (reason == DEFLECTION and deflected)
            or (reason == FROZEN_JOINT and stuck)
            or (jumped and l >= min(m, limits.jump_limit))
        ):
            retraction.doubt_l[i] = 1


@njit(cache=True)
def add_travel(limits, seen, retraction, dt):
    """Add up how far each shaft has turned since the trip, `dt` (s) after the sample before; jumps are no travel."""
    for i in range(3):
        if abs(seen.rate_m[i]) < limits.jump_limit or keeps_moving(limits, seen, i):
            retraction.travel_m[i] += dt * seen.rate_m[i]
        if abs(seen.rate_l[i]) < limits.jump_limit:
            retraction.travel_l[i] += dt * seen.rate_l[i]


@njit(cache=True)
def update_command_bounds(limits, retraction, sent, dt):
    """Keep the most and the least of what is `sent` to the drives (3,), rad/s, forgotten with `obey_lag`.

    A first-order drive of a lag up to `obey_lag` stays between them: at the bound, where omega_m = most, it has
    d omega_m/dt = (omega_ref - omega_m)/T <= (omega_ref - most)/obey_lag = d most/dt.
    """
    share = 1.0 - math.exp(-dt / limits.obey_lag)
    for i in range(3):
        retraction.most[i] = max(sent[i], retraction.most[i] + share * (sent[i] - retraction.most[i]))
        retraction.least[i] = min(sent[i], retraction.least[i] + share * (sent[i] - retraction.least[i]))


@njit(cache=True)
def is_too_fast(limits, seen, retraction, i, retracting):
    """Whether drive `i` turns faster than anything that it was commanded of late, either way, by `follow_limit`.

    Where the motor's encoder is doubted the joint is not to turn down: it swings, and turns back once its spring is
    unwound; once the retraction is over it swings as fast as the retraction was.
    """
    speed, most, least = seen.omega_m[i], retraction.most[i], min(retraction.least[i], -limits.retract_speed)
    if retraction.doubt_m[i]:
        return not retracting and seen.omega_l[i] >= max(most, limits.retract_speed) + limits.follow_limit
    return speed >= most + limits.follow_limit or speed <= least - limits.follow_limit


@njit(cache=True)
def is_too_late(limits, seen, retraction, i, since):
    """Whether drive `i`, `since` (s) the trip, is later in turning back than the slowest drive that obeys.

    By its joint, too, unless that is doubted; by that alone where the motor's encoder is doubted.
    """
    left = math.exp(-max(0.0, since - limits.obey_delay) / limits.obey_lag)
    slowest = (retraction.most[i] + limits.retract_speed) * left - limits.retract_speed
    if retraction.doubt_m[i]:
        return seen.omega_l[i] >= max(0.0, slowest) + limits.follow_limit
    late = seen.omega_m[i] if retraction.doubt_l[i] else min(seen.omega_m[i], seen.omega_l[i])
    return late >= slowest + FOLLOW_SLACK * limits.follow_limit


@njit(cache=True)
def is_too_far(limits, retraction, i):
    """Whether drive `i` has turned by more than `SINK_LIMIT` beyond any that obeys: below its angle at the trip, or up.

    The slowest drive travels on after the trip. The joint tells it where the motor's encoder is doubted, or has not
    moved a count since the trip; it swings up, so that tells nothing.
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
    """Whether force or depth are at their limits, by encoders that are not doubted."""
    doubted_m, doubted_l = retraction.doubt_m.sum() > 0, retraction.doubt_l.sum() > 0
    deep, strong = seen.depth >= limits.penetration_limit, seen.force >= limits.force_limit
    return not doubted_l and (deep or (strong and not doubted_m))


@njit(cache=True)
def cut_power(retraction, i, lines, now):
    """Take the power of drive `i`; of all, where they have no lines of their own."""
    for j in range(3):
        if j == i or not lines:
            retraction.off[j] = 1
    if retraction.power_off_tick < 0:
        retraction.power_off_tick = now
    if retraction.off[0] and retraction.off[1] and retraction.off[2]:
        retraction.power = 0


@njit(cache=True)
def enforce(limits, seen, retraction, lines, now, since, age, unseen):
    """Cut at once drives that, `since` (s) the trip, do not obey the retraction, or race or stray after it.

    Those that no sound encoder shows lose their power when the retraction is over. Once all of them stand still, force
    or depth at a limit cut all.

    Args:
        lines: whether each drive has a line of power of its own.
        now: in ticks.
        age: of the encoder message, in s.
        unseen: whether no encoder message says what the motors do.
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
    """Whether the slowest drive that obeys stands still, to `FOLLOW_SLACK`, `since` (s) the trip: the retraction is over."""
    ended = since - limits.retract / limits.retract_speed - limits.obey_delay
    return limits.retract_speed * math.exp(-max(0.0, ended) / limits.obey_lag) <= FOLLOW_SLACK * limits.follow_limit


@njit(cache=True)
def follow_tolerance(limits, since):
    """Tolerated difference (rad/s) of a motor from its command, `since` (s) the trip: less once all stand still."""
    return (
        FOLLOW_SLACK * limits.follow_limit
        if limits.disobeyed and is_retraction_over(limits, since)
        else limits.follow_limit
    )


@njit(cache=True)
def supervise(limits, seen, retraction, lines, ticks, tick, now, since):
    """Take the power if a joint does not do what the retraction commands for `follow_time`.

    Only a joint whose motor and joint encoder both deny it is at fault: a motor that turns moves its joint, so one of
    the two encoders may be the failure. A doubted joint encoder is not asked; where both are, nothing is judged.

    Args:
        lines: whether each drive has a line of power of its own.
        ticks: since the last valid encoder message, without which no limit is judged.
        tick: in s.
        now: in ticks.
        since: the trip, in s.
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
    theta_m = np.linspace(0.0, retract, RETREAT_STEPS)
    path = position(geometry, joint_angles(geometry, p_B) - theta_m[:, None] / N)
    raised, sideways = path[-1, 2] - path[0, 2], np.hypot(*(path[-1, :2] - path[0, :2]))
    return Retreat(float(raised), float(sideways), float(np.min(np.diff(path[:, 2]) / np.diff(theta_m))))
