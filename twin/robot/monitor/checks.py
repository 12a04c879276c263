"""The limits of the safety monitor: one measured value per reason, all compared by one rule.

A check's share is (value - rest) / (limit - rest), rest being the value at which nothing of the limit is used; it trips
at 1. Checks that count time or look at one raw sample are debounced or not as docs/safety.md argues for each.

Why the monitor trips: codes, and what they say to people.

What the monitor tolerates, and how it retracts.
"""

import math
from enum import IntEnum
from typing import Literal, NamedTuple

import numpy as np

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.port import record, record_of, states
from twin.kernel.settings import Settings, Values, optional, setting, taken

_DEG = math.degrees(1.0)
# times are whole ticks times the tick: a rounding below the limit is the limit
REACHED = 1.0 - 1e-9
# beyond 2^53 a double does not count whole numbers, so no encoder message holds such a count
LARGEST_COUNT = 2.0**53
LARGEST_SAMPLE = 2.0**31
# far beyond any motor; keeps sums and differences of commands finite
LARGEST_COMMAND = 1e6
TIMERS = record(**states(still="3i8", unfollowed="3i8", saturated="3i8", anchor="3f8"))
"""Ticks for which a motor encoder has stood still against its command (signed as the command), a motor has not
followed, a command has been at its limit; motor angle (rad) at which each joint encoder last moved."""


class Reason(IntEnum):
    """Reasons of a trip, in the order in which they win within one evaluation.

    What makes the measurement itself doubtful comes before what is measured.
    """

    NONE = 0
    INVALID_SAMPLE = 1
    STALE = 2
    JUMP = 3
    NO_POSE = 4
    DEFLECTION = 5
    FROZEN_MOTOR = 6
    FROZEN_JOINT = 7
    FORCE = 8
    FORCE_RATE = 9
    PENETRATION = 10
    SPEED = 11
    RADIUS = 12
    TOO_LOW = 13
    TOO_HIGH = 14
    CONTACT_TIME = 15
    INVALID_COMMAND = 16
    SATURATION = 17
    FOLLOW = 18
    HIDDEN_FORCE = 19


class Meaning(NamedTuple):
    """What a reason says.

    Attributes:
        sentence: with `{joint}` where one joint is to blame.
        quantity: what is compared with the limit.
        unit: for people.
        per_si: how many of them are one in SI.
    """

    sentence: str
    quantity: str
    unit: str
    per_si: float


MEANINGS = {
    Reason.INVALID_SAMPLE: Meaning("the encoder message holds what is not a number", "invalid values", "", 1.0),
    Reason.STALE: Meaning("the encoder messages are not those of their time", "off by", "ms", 1e3),
    Reason.JUMP: Meaning(
        "joint {joint}: an encoder jumped further than drive and joint can move", "motor-side speed", "rad/s", 1.0
    ),
    Reason.NO_POSE: Meaning("the joint angles fit no pose of the robot", "unfit samples", "", 1.0),
    Reason.DEFLECTION: Meaning(
        "joint {joint}: the spring is deflected too far, or an encoder is wrong", "deflection", "deg", _DEG
    ),
    Reason.FROZEN_MOTOR: Meaning(
        "joint {joint}: the motor encoder stands still although the motor is commanded to move", "for", "ms", 1e3
    ),
    Reason.FROZEN_JOINT: Meaning(
        "joint {joint}: the joint encoder stands still although the motor moves", "motor travel", "deg", _DEG
    ),
    Reason.FORCE: Meaning("the robot presses too hard", "|F_ee_B|", "N", 1.0),
    Reason.FORCE_RATE: Meaning("the force grows too fast", "rate", "N/s", 1.0),
    Reason.PENETRATION: Meaning("the robot is too far below its first contact", "depth", "mm", 1e3),
    Reason.SPEED: Meaning("the platform moves too fast", "speed", "mm/s", 1e3),
    Reason.RADIUS: Meaning("the platform left the workspace sideways", "distance from the axis", "mm", 1e3),
    Reason.TOO_LOW: Meaning("the platform left the workspace downwards", "z", "mm", 1e3),
    Reason.TOO_HIGH: Meaning("the platform left the workspace upwards", "z", "mm", 1e3),
    Reason.CONTACT_TIME: Meaning("the robot has pressed too long without a pause", "contact time", "s", 1.0),
    Reason.INVALID_COMMAND: Meaning("the controller commands what is not a number", "invalid values", "", 1.0),
    Reason.SATURATION: Meaning("joint {joint}: the command has stayed at its limit", "for", "ms", 1e3),
    Reason.FOLLOW: Meaning("joint {joint}: the motor does not follow its command", "for", "ms", 1e3),
    Reason.HIDDEN_FORCE: Meaning(
        "the motors give way to more force than the encoders show: an encoder is wrong", "for", "ms", 1e3
    ),
}


class Trip(NamedTuple):
    """A trip as it was latched.

    Attributes:
        tick: of the evaluation that tripped.
        reason: what won.
        value, limit: what was compared, SI.
        joint: 1, 2 or 3 where one joint is to blame, else 0.
    """

    tick: int
    reason: Reason
    value: float
    limit: float
    joint: int


def trip_sentence(trip: Trip) -> str:
    """One sentence on a trip: who, what, the measured value and its limit."""
    meaning = MEANINGS[trip.reason]
    unit = f" {meaning.unit}" if meaning.unit else ""
    value, limit = meaning.per_si * trip.value, meaning.per_si * trip.limit
    sentence = meaning.sentence.format(joint=trip.joint)
    return f"safety monitor: {sentence}: {meaning.quantity} {value:.4g}{unit}, limit {limit:.4g}{unit}"


class Monitor(Settings):
    """[monitor]: a table without keys is complete. The defaults suit a massage at 3 to 8 N.

    A command counts as saturated at `command_limit`, by default the controller's own limit.
    """

    enabled: bool = setting(default=True, help="false: no monitor")
    period: float = setting("ms", into=None, default=2.0, gt=0, help="time between two looks")
    force_limit: float = setting("N", default=15.0, gt=0, help="length of the force, in any direction, that trips")
    force_rate_limit: float = setting("N/s", default=300.0, gt=0, help="force rate that trips")
    contact_force: float = setting("N", default=1.0, gt=0, help="force that counts as contact")
    penetration_limit: float = setting("mm", default=25.0, gt=0, help="depth below first contact that trips")
    contact_time_limit: float = setting("s", default=120.0, gt=0, help="contact without a break that trips")
    speed_limit: float = setting("mm/s", default=250.0, gt=0, help="platform speed that trips")
    workspace_radius: float = setting("mm", default=40.0, gt=0, help="distance from the z axis that trips")
    z_min: float = setting("mm", default=-135.0, lt=0, help="lowest z")
    z_max: float = setting("mm", default=-75.0, lt=0, help="highest z")
    deflection_limit: float = setting("deg", default=20.0, gt=0, help="spring deflection that trips")
    jump_limit: float = setting(
        "rad/s", default=25.0, gt=0, help="change of a spring's deflection that no motion explains"
    )
    stale_time: float = setting("ms", default=10.0, gt=0, help="time without a new encoder message that trips")
    frozen_demand: float = setting("rad/s", default=0.5, gt=0, help="commanded speed at which a shaft has to move")
    frozen_time: float = setting("ms", default=100.0, gt=0, help="time for which it may stand still")
    frozen_travel: float = setting("deg", default=8.0, gt=0, help="commanded travel without a count that trips")
    command_limit: float | None = optional(
        "rad/s", gt=0, example=8.0, help="command that counts as saturated; without it the controller's own limit"
    )
    saturation_time: float = setting("ms", default=500.0, gt=0, help="time of a saturated command that trips")
    follow_limit: float = setting(
        "rad/s", default=1.5, gt=0, help="difference of commanded and measured motor speed that trips"
    )
    follow_time: float = setting("ms", default=150.0, gt=0, help="time for which it has to last")
    drive_droop: float | None = optional(
        "rad/s/(N m)",
        gt=0,
        absent=0.0,
        example=0.6,
        help="speed that the drives are believed to lose per load; without it no look for a hidden force",
    )
    drive_lag: float = setting("ms", default=0.0, ge=0, help="believed time constant of the drives' speed")
    hidden_force_limit: float = setting(
        "N", default=8.0, gt=0, help="pressing force that the motors feel and the encoders do not show, that trips"
    )
    hidden_time: float = setting("ms", default=500.0, gt=0, help="time for which it has to last")
    filter: float = setting("Hz", default=20.0, gt=0, help="low-pass of speeds and rates")
    retract: float = setting("deg", default=30.0, gt=0, help="how far a trip turns the motors back")
    retract_speed: float = setting("rad/s", default=2.0, gt=0, help="how fast")
    disobeyed: Literal["wait", "cut"] = setting(
        default="cut",
        help="power of drives that do not obey the retraction: cut at once, or after follow_time_ms",
    )
    obey_delay: float = setting("ms", default=10.0, ge=0, help="after a trip no drive has to turn back for so long")
    obey_lag: float = setting("ms", default=100.0, gt=0, help="time constant of the slowest drive that obeys")
    release_time: float = setting(
        "ms", default=1000.0, ge=0, help="without power, how long a brake with a line of its own may stay open"
    )


class Limits(Values, parts=(taken(Monitor),)):
    """Limits of the monitor, SI, and how it retracts.

    A check trips when its limit is reached; a contact ends at half of the force at which it begins. docs/safety.md says
    what each is for.
    """


LIMITS = record_of(Limits)


REASONS = len(Reason)


(
    INVALID_SAMPLE, STALE, JUMP, NO_POSE, DEFLECTION, FROZEN_MOTOR, FROZEN_JOINT, FORCE, FORCE_RATE, PENETRATION, SPEED,
    RADIUS, TOO_LOW, TOO_HIGH, CONTACT_TIME, INVALID_COMMAND, SATURATION, FOLLOW, HIDDEN_FORCE,
) = (int(reason) for reason in Reason if reason is not Reason.NONE)  # fmt: skip


def thresholds(limits: Limits) -> tuple[np.ndarray, np.ndarray]:
    """Limit and rest of every reason, (REASONS,) each, SI; that of NONE is never reached."""
    limit, rest = np.full(REASONS, math.inf), np.zeros(REASONS)
    limit[1:] = [
        1.0, limits.stale_time, limits.jump_limit, 1.0, limits.deflection_limit, limits.frozen_time,
        limits.frozen_travel, limits.force_limit, limits.force_rate_limit, limits.penetration_limit, limits.speed_limit,
        limits.workspace_radius, limits.z_min, limits.z_max, limits.contact_time_limit, 1.0, limits.saturation_time,
        limits.follow_time, limits.hidden_time,
    ]  # fmt: skip
    rest[[Reason.TOO_LOW, Reason.TOO_HIGH]] = 0.5 * (limits.z_min + limits.z_max)
    return limit, rest


@njit(cache=True)
def unusable(values, largest):
    """How many of `values` are not finite or not below `largest` in magnitude."""
    n = 0
    for i in range(values.shape[0]):
        # not >=: that would let NaN pass
        if not abs(values[i]) < largest:
            n += 1
    return n


@njit(cache=True)
def put_largest(values, joints, reason, x, scale):
    """Keep the largest magnitude among `x` (3,), times `scale`, as the value of `reason`, and whose joint it is."""
    worst = 0
    for i in range(1, 3):
        if abs(x[i]) > abs(x[worst]):
            worst = i
    values[reason] = scale * abs(x[worst])
    joints[reason] = worst + 1


@njit(cache=True)
def time_joints(limits, seen, timers, sent, ticks):
    """Advance what is timed per joint by the `ticks` between two samples, in which `sent` (3,) was commanded."""
    for i in range(3):
        demand = sent[i]
        if seen.moved_m[i] or abs(demand) <= limits.frozen_demand:
            timers.still[i] = 0
        elif demand > 0.0:
            timers.still[i] = max(timers.still[i], 0) + ticks
        else:
            timers.still[i] = min(timers.still[i], 0) - ticks
        if seen.moved_l[i] or not seen.started:
            timers.anchor[i] = seen.theta_m[i]
        astray = abs(seen.omega_cmd[i] - seen.omega_m[i]) >= limits.follow_limit
        timers.unfollowed[i] = timers.unfollowed[i] + ticks if astray else 0


@njit(cache=True)
def value_sample(seen, timers, values, joints, tick):
    """The values of all checks on encoder messages; `tick` in s."""
    put_largest(values, joints, JUMP, seen.fastest, 1.0)
    put_largest(values, joints, DEFLECTION, seen.deflection, 1.0)
    put_largest(values, joints, FROZEN_MOTOR, timers.still, tick)
    put_largest(values, joints, FOLLOW, timers.unfollowed, tick)
    worst = 0
    for i in range(1, 3):
        if abs(seen.theta_m[i] - timers.anchor[i]) > abs(seen.theta_m[worst] - timers.anchor[worst]):
            worst = i
    values[FROZEN_JOINT] = abs(seen.theta_m[worst] - timers.anchor[worst])
    joints[FROZEN_JOINT] = worst + 1
    values[FORCE] = seen.force
    values[FORCE_RATE] = max(0.0, seen.force_rate)
    values[PENETRATION] = seen.depth
    values[SPEED] = seen.speed
    values[RADIUS] = math.sqrt(seen.p_B[0] * seen.p_B[0] + seen.p_B[1] * seen.p_B[1])
    values[TOO_LOW] = seen.p_B[2]
    values[TOO_HIGH] = seen.p_B[2]
    values[CONTACT_TIME] = tick * seen.contact_ticks
    values[HIDDEN_FORCE] = tick * seen.hidden_ticks


@njit(cache=True)
def value_command(limits, timers, omega_ref, values, joints, ticks, tick):
    """The values of the checks on the command `omega_ref` (3,), rad/s, `ticks` after the one before."""
    values[INVALID_COMMAND] = unusable(omega_ref, LARGEST_COMMAND)
    for i in range(3):
        saturated = abs(omega_ref[i]) >= REACHED * limits.command_limit
        timers.saturated[i] = timers.saturated[i] + ticks if saturated else 0
    put_largest(values, joints, SATURATION, timers.saturated, tick)


@njit(cache=True, error_model="numpy")
def first_reached(values, limit, rest):
    """The first reason whose limit is reached (0: none), and the largest share of any limit in use."""
    reason, utilisation = 0, 0.0
    for k in range(1, REASONS):
        share = (values[k] - rest[k]) / (limit[k] - rest[k])
        utilisation = max(utilisation, share)
        if reason == 0 and share >= REACHED:
            reason = k
    return reason, utilisation
