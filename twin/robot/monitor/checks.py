"""Checks of the safety monitor: one measured value per reason, all compared with their limits by one rule.

A check's share is (value - rest) / (limit - rest), where the rest is the value without any load; it trips at 1.
docs/safety.md argues which checks count time, are low-passed, or trip on one raw sample.
"""

import math

import numpy as np

from twin.kernel.compiled.function import njit
from twin.kernel.cosim.port import record, states
from twin.robot.monitor.limits import Limits
from twin.robot.monitor.reasons import REASON_COUNT, Reason

# times are whole ticks times the tick: a value that rounds to just below its limit has reached it
REACHED_SHARE = 1.0 - 1e-9
# doubles represent all integers up to 2^53 only
MAX_COUNT = 2.0**53
MAX_SAMPLE_NUMBER = 2.0**31
# far beyond any motor, so that sums and differences of commands stay finite
MAX_COMMAND = 1e6
TIMERS_RECORD = record(**states(still="3i8", unfollowed="3i8", saturated="3i8", anchor="3f8"))
"""Ticks: motor encoder without a count against its command (signed as the command), motor off its command, command at
its limit; and the motor angle (rad) of the last movement of each joint encoder."""


def thresholds(limits: Limits) -> tuple[np.ndarray, np.ndarray]:
    """Return limit and rest value of every trip reason, (REASON_COUNT,) each, SI.

    The limits of NONE, and of SILENT without a remote controller, are infinite.
    """
    limit, rest = np.full(REASON_COUNT, math.inf), np.zeros(REASON_COUNT)
    limit[1:] = [
        1.0, limits.stale_time, limits.jump_limit, 1.0, limits.deflection_limit, limits.frozen_time,
        limits.frozen_travel, limits.force_limit, limits.force_rate_limit, limits.penetration_limit, limits.speed_limit,
        limits.workspace_radius, limits.z_min, limits.z_max, limits.contact_time_limit, 1.0, limits.saturation_time,
        limits.follow_time, limits.hidden_time, math.inf,
    ]  # fmt: skip
    rest[[Reason.TOO_LOW, Reason.TOO_HIGH]] = 0.5 * (limits.z_min + limits.z_max)
    return limit, rest


@njit(cache=True)
def count_unusable(values, largest):
    """Count the `values` that are unusable: not finite, or not below `largest` in magnitude."""
    n = 0
    for i in range(values.shape[0]):
        # not >=: that would let NaN pass
        if not abs(values[i]) < largest:
            n += 1
    return n


@njit(cache=True)
def store_largest(values, joints, reason, x, scale):
    """Store the largest magnitude of `x` (3,), times `scale`, as the value of a check, and its index as the joint."""
    worst = 0
    for i in range(1, 3):
        if abs(x[i]) > abs(x[worst]):
            worst = i
    values[reason] = scale * abs(x[worst])
    joints[reason] = worst + 1


@njit(cache=True)
def update_timers(limits, seen, timers, sent, ticks):
    """Advance each joint's timers (frozen encoder, unfollowed command, saturation) by the `ticks` between samples."""
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
    """Compute the values of all monitor checks on the encoder messages; `tick` in s."""
    store_largest(values, joints, Reason.JUMP, seen.fastest, 1.0)
    store_largest(values, joints, Reason.DEFLECTION, seen.deflection, 1.0)
    store_largest(values, joints, Reason.FROZEN_MOTOR, timers.still, tick)
    store_largest(values, joints, Reason.FOLLOW, timers.unfollowed, tick)
    worst = 0
    for i in range(1, 3):
        if abs(seen.theta_m[i] - timers.anchor[i]) > abs(seen.theta_m[worst] - timers.anchor[worst]):
            worst = i
    values[Reason.FROZEN_JOINT] = abs(seen.theta_m[worst] - timers.anchor[worst])
    joints[Reason.FROZEN_JOINT] = worst + 1
    values[Reason.FORCE] = seen.force
    values[Reason.FORCE_RATE] = max(0.0, seen.force_rate)
    values[Reason.PENETRATION] = seen.depth
    values[Reason.SPEED] = seen.speed
    values[Reason.RADIUS] = math.sqrt(seen.p_B[0] * seen.p_B[0] + seen.p_B[1] * seen.p_B[1])
    values[Reason.TOO_LOW] = seen.p_B[2]
    values[Reason.TOO_HIGH] = seen.p_B[2]
    values[Reason.CONTACT_TIME] = tick * seen.contact_ticks
    values[Reason.HIDDEN_FORCE] = tick * seen.hidden_ticks


@njit(cache=True)
def evaluate_command(limits, timers, omega_ref, values, joints, ticks, tick):
    """Compute the monitor checks on the command `omega_ref` (3,), rad/s, `ticks` after the previous command."""
    values[Reason.INVALID_COMMAND] = count_unusable(omega_ref, MAX_COMMAND)
    for i in range(3):
        saturated = abs(omega_ref[i]) >= REACHED_SHARE * limits.command_limit
        timers.saturated[i] = timers.saturated[i] + ticks if saturated else 0
    store_largest(values, joints, Reason.SATURATION, timers.saturated, tick)


@njit(cache=True, error_model="numpy")
def first_violation(values, limit, rest):
    """Return the code of the first reason with a reached limit (0 if all are kept), and the largest share of a
    limit."""
    reason, utilisation = 0, 0.0
    for k in range(1, REASON_COUNT):
        share = (values[k] - rest[k]) / (limit[k] - rest[k])
        utilisation = max(utilisation, share)
        if reason == 0 and share >= REACHED_SHARE:
            reason = k
    return reason, utilisation
