"""The limits of the safety monitor: one measured value per reason, all compared by one rule.

A check's share is (value - rest) / (limit - rest), rest being the value at which nothing of the limit is used; it trips
at 1. Checks that count time or look at one raw sample are debounced or not as docs/safety.md argues for each.
"""

import math

import numpy as np

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.port import record, states
from twin.robot.monitor.limits import Limits
from twin.robot.monitor.reasons import (
    CONTACT_TIME,
    DEFLECTION,
    FOLLOW,
    FORCE,
    FORCE_RATE,
    FROZEN_JOINT,
    FROZEN_MOTOR,
    HIDDEN_FORCE,
    INVALID_COMMAND,
    JUMP,
    PENETRATION,
    RADIUS,
    REASON_COUNT,
    SATURATION,
    SPEED,
    TOO_HIGH,
    TOO_LOW,
    Reason,
)

# times are whole ticks times the tick: a rounding below the limit is the limit
REACHED_SHARE = 1.0 - 1e-9
# beyond 2^53 a double does not count whole numbers, so no encoder message holds such a count
MAX_COUNT = 2.0**53
MAX_SAMPLE_NUMBER = 2.0**31
# far beyond any motor; keeps sums and differences of commands finite
MAX_COMMAND = 1e6
TIMERS_RECORD = record(**states(still="3i8", unfollowed="3i8", saturated="3i8", anchor="3f8"))
"""Ticks for which a motor encoder has stood still against its command (signed as the command), a motor has not
followed, a command has been at its limit; motor angle (rad) at which each joint encoder last moved."""


def thresholds(limits: Limits) -> tuple[np.ndarray, np.ndarray]:
    """Limit and rest of every reason, (REASONS,) each, SI; that of NONE is never reached."""
    limit, rest = np.full(REASON_COUNT, math.inf), np.zeros(REASON_COUNT)
    limit[1:] = [
        1.0, limits.stale_time, limits.jump_limit, 1.0, limits.deflection_limit, limits.frozen_time,
        limits.frozen_travel, limits.force_limit, limits.force_rate_limit, limits.penetration_limit, limits.speed_limit,
        limits.workspace_radius, limits.z_min, limits.z_max, limits.contact_time_limit, 1.0, limits.saturation_time,
        limits.follow_time, limits.hidden_time,
    ]  # fmt: skip
    rest[[Reason.TOO_LOW, Reason.TOO_HIGH]] = 0.5 * (limits.z_min + limits.z_max)
    return limit, rest


@njit(cache=True)
def count_unusable(values, largest):
    """How many of `values` are not finite or not below `largest` in magnitude."""
    n = 0
    for i in range(values.shape[0]):
        # not >=: that would let NaN pass
        if not abs(values[i]) < largest:
            n += 1
    return n


@njit(cache=True)
def store_largest(values, joints, reason, x, scale):
    """Keep the largest magnitude among `x` (3,), times `scale`, as the value of `reason`, and whose joint it is."""
    worst = 0
    for i in range(1, 3):
        if abs(x[i]) > abs(x[worst]):
            worst = i
    values[reason] = scale * abs(x[worst])
    joints[reason] = worst + 1


@njit(cache=True)
def update_timers(limits, seen, timers, sent, ticks):
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
def evaluate_sample(seen, timers, values, joints, tick):
    """The values of all checks on encoder messages; `tick` in s."""
    store_largest(values, joints, JUMP, seen.fastest, 1.0)
    store_largest(values, joints, DEFLECTION, seen.deflection, 1.0)
    store_largest(values, joints, FROZEN_MOTOR, timers.still, tick)
    store_largest(values, joints, FOLLOW, timers.unfollowed, tick)
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
def evaluate_command(limits, timers, omega_ref, values, joints, ticks, tick):
    """The values of the checks on the command `omega_ref` (3,), rad/s, `ticks` after the one before."""
    values[INVALID_COMMAND] = count_unusable(omega_ref, MAX_COMMAND)
    for i in range(3):
        saturated = abs(omega_ref[i]) >= REACHED_SHARE * limits.command_limit
        timers.saturated[i] = timers.saturated[i] + ticks if saturated else 0
    store_largest(values, joints, SATURATION, timers.saturated, tick)


@njit(cache=True, error_model="numpy")
def first_violation(values, limit, rest):
    """The first reason whose limit is reached (0: none), and the largest share of any limit in use."""
    reason, utilisation = 0, 0.0
    for k in range(1, REASON_COUNT):
        share = (values[k] - rest[k]) / (limit[k] - rest[k])
        utilisation = max(utilisation, share)
        if reason == 0 and share >= REACHED_SHARE:
            reason = k
    return reason, utilisation
