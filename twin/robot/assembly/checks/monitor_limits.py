"""Consistency of the limits of [monitor] with each other and with the robot."""

import math

from twin.kernel.errors import InputRefused
from twin.robot.mechanism.geometry import geometry_of
from twin.robot.mechanism.unreachable import Unreachable
from twin.robot.monitor.component import MonitorBelief, Resolution, press_deflection, resolution
from twin.robot.monitor.component import low_pass_share as monitor_share
from twin.robot.monitor.limits import Monitor
from twin.robot.monitor.safe_action import retreat

MIN_RESOLUTION_RATIO = 3.0
"""Minimum ratio of a limit to the encoders' resolution, so that rounding alone stays well below it."""
DEFLECTION_MARGIN, MAX_DEFLECTION = 1.25, 45.0
"""Ratio of a raised deflection limit to the deflection at rest by weight or force; its maximum (deg)."""
SAFETY_LIMITS = ("force_limit", "penetration_limit", "speed_limit")
"""Limits that protect the person, so a robot's resolution never raises them."""


def contradictions(monitor: Monitor, belief: MonitorBelief, sample_period: float, speed_limit: float) -> list[str]:
    """Return an error message for each contradiction of the limits of [monitor]; empty if it is disabled.

    `sample_period` of encoder messages and commands in s, `speed_limit` of the controller's commands in rad/s.
    """
    if not monitor.enabled:
        return []
    if monitor.z_min >= monitor.z_max:
        # the other checks need the middle of the workspace
        return [
            f"[monitor] z_min_mm = {1e3 * monitor.z_min:g} is not below z_max_mm = {1e3 * monitor.z_max:g}; "
            "exchange them",
            *_time_contradictions(monitor, sample_period, speed_limit),
        ]
    return [
        *_time_contradictions(monitor, sample_period, speed_limit),
        *_robot_contradictions(monitor, belief, sample_period),
        *_retraction_contradictions(monitor, belief),
    ]


def raised_limits(monitor: Monitor, belief: MonitorBelief) -> dict[str, float]:
    """Return by key the limits of [monitor] that a robot's encoders and springs need higher, to two digits.

    Raises:
        Unreachable: the middle of the monitor's workspace is out of reach.
        InputRefused: weight or force bend the springs too far.
    """
    p_B = (0.0, 0.0, 0.5 * (monitor.z_min + monitor.z_max))
    share = monitor_share(monitor.filter, monitor.period)
    needed = {
        f"{key}_{unit}": MIN_RESOLUTION_RATIO * scale * resolved
        for key, unit, scale, resolved in _resolution_limits(resolution(belief, p_B, monitor.period), share)
        if key not in SAFETY_LIMITS and getattr(monitor, key) < MIN_RESOLUTION_RATIO * resolved
    }
    # without contact the springs carry the weight
    bent = max(math.degrees(press_deflection(belief, p_B, force)) for force in (0.0, monitor.force_limit))
    if bent > MAX_DEFLECTION:
        raise InputRefused(
            f"springs too soft: weight or {monitor.force_limit:g} N bend them by {bent:.3g} deg, expected at "
            f"most {MAX_DEFLECTION:g}; add --set robot.k_s_Nm_per_rad={belief.k_s * 2.0 * bent / MAX_DEFLECTION:.2g}"
        )
    if math.degrees(monitor.deflection_limit) < DEFLECTION_MARGIN * bent:
        needed["deflection_limit_deg"] = DEFLECTION_MARGIN * bent
    # rounded up: 5 % more is more than half a step of the second digit
    return {key: float(f"{1.05 * value:.2g}") for key, value in needed.items()}


def _time_contradictions(monitor: Monitor, sample_period: float, speed_limit: float) -> list[str]:
    mistakes = []
    shortest = max(monitor.period, sample_period)
    for key in ("stale_time", "frozen_time", "saturation_time", "follow_time", "hidden_time"):
        if getattr(monitor, key) <= shortest:
            mistakes.append(
                f"[monitor] {key}_ms = {1e3 * getattr(monitor, key):g} is no longer than one sample of "
                f"{1e3 * shortest:g} ms; allow several samples"
            )
    if monitor.contact_force >= monitor.force_limit:
        mistakes.append(
            f"[monitor] contact_force_N = {monitor.contact_force:g} is not below force_limit_N = "
            f"{monitor.force_limit:g}; lower it, or no contact is ever seen"
        )
    if monitor.period > sample_period:
        mistakes.append(
            f"[monitor] period_ms = {1e3 * monitor.period:g} holds back the controller's commands, which come every "
            f"{1e3 * sample_period:g} ms; expected at most that"
        )
    if monitor.command_limit is not None and monitor.command_limit > speed_limit:
        mistakes.append(
            f"[monitor] command_limit_rad_per_s = {monitor.command_limit:g} is never reached: the controller commands "
            f"at most {speed_limit:g} rad/s; expected at most that"
        )
    if monitor.retract_speed <= monitor.follow_limit:
        mistakes.append(
            f"[monitor] retract_speed_rad_per_s = {monitor.retract_speed:g} is not above follow_limit_rad_per_s = "
            f"{monitor.follow_limit:g}: a jam would go unseen; raise the one or lower the other"
        )
    return mistakes


def _robot_contradictions(monitor: Monitor, belief: MonitorBelief, sample_period: float) -> list[str]:
    p_B = (0.0, 0.0, 0.5 * (monitor.z_min + monitor.z_max))
    at = f"at z = {1e3 * p_B[2]:g} mm"
    try:
        deflection = press_deflection(belief, p_B, monitor.force_limit)
        one_count = resolution(belief, p_B, sample_period)
    except Unreachable as problem:
        return [f"[monitor] the middle of z_min_mm and z_max_mm: {problem}"]
    mistakes = []
    if deflection >= monitor.deflection_limit:
        mistakes.append(
            f"[monitor] force_limit_N = {monitor.force_limit:g} is never reached: {at} it deflects a spring by "
            f"{math.degrees(deflection):.1f} deg (k_s N eta = {belief.k_s * belief.N * belief.eta:g} N m/rad), and "
            f"deflection_limit_deg = {math.degrees(monitor.deflection_limit):g} trips before; lower the force limit "
            "or raise the other"
        )
    share = monitor_share(monitor.filter, sample_period)
    for key, unit, scale, resolved in _resolution_limits(one_count, share):
        if getattr(monitor, key) < MIN_RESOLUTION_RATIO * resolved:
            mistakes.append(
                f"[monitor] {key}_{unit} = {scale * getattr(monitor, key):g} is below the resolution of the "
                f"encoders: one count is worth {scale * resolved:.3g} {at}; expected at least "
                f"{MIN_RESOLUTION_RATIO:g} times that"
            )
    return mistakes


def _resolution_limits(one_count: Resolution, share: float) -> list[tuple[str, str, float, float]]:
    """Return the monitor's limits that the encoder resolution bounds from below.

    Each entry: attribute, unit of its key, that unit per SI unit, filtered value of one encoder count.
    """
    return [
        ("force_limit", "N", 1.0, one_count.force),
        ("contact_force", "N", 1.0, one_count.force),
        ("penetration_limit", "mm", 1e3, one_count.position),
        ("deflection_limit", "deg", math.degrees(1.0), one_count.deflection),
        ("frozen_travel", "deg", math.degrees(1.0), one_count.deflection),
        ("jump_limit", "rad_per_s", 1.0, one_count.jump),
        ("speed_limit", "mm_per_s", 1e3, share * one_count.velocity),
        ("force_rate_limit", "N_per_s", 1.0, share * one_count.force_rate),
        ("follow_limit", "rad_per_s", 1.0, share * one_count.motor_speed),
    ]


def _retraction_contradictions(monitor: Monitor, belief: MonitorBelief) -> list[str]:
    """Return an error if the retraction does not raise the platform at top and bottom of the workspace."""
    for z in (monitor.z_max, monitor.z_min):
        for angle in range(0, 360, 30):
            x = monitor.workspace_radius * math.cos(math.radians(angle))
            y = monitor.workspace_radius * math.sin(math.radians(angle))
            where = f"from ({1e3 * x:.0f}, {1e3 * y:.0f}, {1e3 * z:.0f}) mm"
            try:
                rises = retreat(geometry_of(belief), belief.N, (x, y, z), monitor.retract).slowest > 0.0
            except Unreachable as problem:
                return [f"[monitor] the workspace or the retraction leaves the robot's reach {where}: {problem}"]
            if not rises:
                return [
                    f"[monitor] retract_deg = {math.degrees(monitor.retract):g} is longer than the workspace: {where} "
                    "the platform would sink again at the end; retract less or lower z_max_mm"
                ]
    return []
