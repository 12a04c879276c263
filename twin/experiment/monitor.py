"""[monitor]: the safety monitor's limits, and the contradictions among them. docs/safety.md argues each default."""

import math

from pydantic import Field

from twin.errors import Unreachable
from twin.experiment.quantity import Section, quantity
from twin.monitor.belief import Belief
from twin.monitor.limits import Limits
from twin.monitor.observation import low_pass_share
from twin.monitor.resolution import Resolution, press_wind_up, resolution
from twin.monitor.retraction import retreat
from twin.robot.geometry import Geometry

DISTINCT = 3.0
"""A limit has to be this many times what the encoders resolve, or rounding alone comes near it."""


class Monitor(Section):
    """[monitor]: a table without keys is complete. The defaults suit a massage at 3 to 8 N.

    A command counts as saturated at `command_limit`, by default the controller's own limit.
    """

    enabled: bool = Field(default=True, description="false: nobody watches")
    period: float = quantity("period_ms", 2.0, gt=0, description="time between two looks")
    force_limit: float = quantity(
        "force_limit_N", 15.0, gt=0, description="length of the force, in any direction, that trips"
    )
    force_rate_limit: float = quantity("force_rate_limit_N_per_s", 300.0, gt=0, description="force rate that trips")
    contact_force: float = quantity("contact_force_N", 1.0, gt=0, description="force that counts as contact")
    penetration_limit: float = quantity(
        "penetration_limit_mm", 25.0, gt=0, description="depth below first contact that trips"
    )
    contact_time_limit: float = quantity(
        "contact_time_limit_s", 120.0, gt=0, description="contact without a break that trips"
    )
    speed_limit: float = quantity("speed_limit_mm_per_s", 250.0, gt=0, description="platform speed that trips")
    workspace_radius: float = quantity(
        "workspace_radius_mm", 40.0, gt=0, description="distance from the z axis that trips"
    )
    z_min: float = quantity("z_min_mm", -135.0, lt=0, description="lowest z")
    z_max: float = quantity("z_max_mm", -75.0, lt=0, description="highest z")
    deflection_limit: float = quantity("deflection_limit_deg", 20.0, gt=0, description="spring wind-up that trips")
    jump_limit: float = quantity(
        "jump_limit_rad_per_s", 25.0, gt=0, description="change of a spring's wind-up that no motion explains"
    )
    stale_time: float = quantity(
        "stale_time_ms", 10.0, gt=0, description="time without a new encoder message that trips"
    )
    frozen_demand: float = quantity(
        "frozen_demand_rad_per_s", 0.5, gt=0, description="commanded speed at which a shaft has to move"
    )
    frozen_time: float = quantity("frozen_time_ms", 100.0, gt=0, description="time for which it may stand still")
    frozen_travel: float = quantity(
        "frozen_travel_deg", 8.0, gt=0, description="commanded travel without a count that trips"
    )
    command_limit: float | None = quantity(
        "command_limit_rad_per_s",
        None,
        gt=0,
        examples=[8.0],
        description="command that counts as saturated; without it the controller's own limit",
    )
    saturation_time: float = quantity(
        "saturation_time_ms", 500.0, gt=0, description="time of a saturated command that trips"
    )
    follow_limit: float = quantity(
        "follow_limit_rad_per_s", 1.5, gt=0, description="difference of commanded and measured motor speed that trips"
    )
    follow_time: float = quantity("follow_time_ms", 150.0, gt=0, description="time for which it has to last")
    filter: float = quantity("filter_Hz", 20.0, gt=0, description="low-pass of speeds and rates")
    retract: float = quantity("retract_deg", 30.0, gt=0, description="how far a trip turns the motors back")
    retract_speed: float = quantity("retract_speed_rad_per_s", 2.0, gt=0, description="how fast")


def limits(monitor: Monitor, speed_limit: float) -> Limits:
    """The limits of [monitor] as the component takes them; `speed_limit`: of the controller's commands (rad/s)."""
    given = {name: getattr(monitor, name) for name in Limits._fields}
    return Limits(**{**given, "command_limit": monitor.command_limit or speed_limit})


def contradictions(monitor: Monitor, belief: Belief, sample_period: float, speed_limit: float) -> list[str]:
    """Every way in which the limits of [monitor] cannot all mean something, one sentence each; none if not enabled.

    Args:
        belief: the monitor's model of the robot.
        sample_period: between two encoder messages, and between two commands (s).
        speed_limit: of the controller's commands (rad/s).
    """
    if not monitor.enabled:
        return []
    if monitor.z_min >= monitor.z_max:
        # no middle of the workspace to look at the others from
        return [
            f"[monitor] z_min_mm = {1e3 * monitor.z_min:g} is not below z_max_mm = {1e3 * monitor.z_max:g}; "
            "exchange them",
            *_among_times(monitor, sample_period, speed_limit),
        ]
    return [
        *_among_times(monitor, sample_period, speed_limit),
        *_against_robot(monitor, belief, sample_period),
        *_of_retraction(monitor, belief),
    ]


def _among_times(monitor: Monitor, sample_period: float, speed_limit: float) -> list[str]:
    told = []
    shortest = max(monitor.period, sample_period)
    for key in ("stale_time", "frozen_time", "saturation_time", "follow_time"):
        if getattr(monitor, key) <= shortest:
            told.append(
                f"[monitor] {key}_ms = {1e3 * getattr(monitor, key):g} is no longer than one sample of "
                f"{1e3 * shortest:g} ms; allow several samples"
            )
    if monitor.contact_force >= monitor.force_limit:
        told.append(
            f"[monitor] contact_force_N = {monitor.contact_force:g} is not below force_limit_N = "
            f"{monitor.force_limit:g}; lower it, or no contact is ever seen"
        )
    if monitor.period > sample_period:
        told.append(
            f"[monitor] period_ms = {1e3 * monitor.period:g} holds back the controller's commands, which come every "
            f"{1e3 * sample_period:g} ms; expected at most that"
        )
    if monitor.command_limit is not None and monitor.command_limit > speed_limit:
        told.append(
            f"[monitor] command_limit_rad_per_s = {monitor.command_limit:g} is never reached: the controller commands "
            f"at most {speed_limit:g} rad/s; expected at most that"
        )
    if monitor.retract_speed <= monitor.follow_limit:
        told.append(
            f"[monitor] retract_speed_rad_per_s = {monitor.retract_speed:g} is not above follow_limit_rad_per_s = "
            f"{monitor.follow_limit:g}: a jam would go unseen; raise the one or lower the other"
        )
    return told


def _against_robot(monitor: Monitor, belief: Belief, sample_period: float) -> list[str]:
    p_B = (0.0, 0.0, 0.5 * (monitor.z_min + monitor.z_max))
    at = f"at z = {1e3 * p_B[2]:g} mm"
    try:
        wind_up = press_wind_up(belief, p_B, monitor.force_limit)
        one_count = resolution(belief, p_B, sample_period)
    except Unreachable as problem:
        return [f"[monitor] the middle of z_min_mm and z_max_mm: {problem}"]
    told = []
    if wind_up >= monitor.deflection_limit:
        told.append(
            f"[monitor] force_limit_N = {monitor.force_limit:g} is never reached: {at} it winds a spring up by "
            f"{math.degrees(wind_up):.1f} deg (k_s N eta = {belief.k_s * belief.N * belief.eta:g} N m/rad), and "
            f"deflection_limit_deg = {math.degrees(monitor.deflection_limit):g} trips before; lower the force limit "
            "or raise the other"
        )
    share = low_pass_share(monitor.filter, sample_period)
    for key, unit, scale, resolved in _resolved(one_count, share):
        if getattr(monitor, key) < DISTINCT * resolved:
            told.append(
                f"[monitor] {key}_{unit} = {scale * getattr(monitor, key):g} is within what the encoders cannot tell "
                f"apart: one count is worth {scale * resolved:.3g} {at}; expected at least {DISTINCT:g} times that"
            )
    return told


def _resolved(one_count: Resolution, share: float) -> list[tuple[str, str, float, float]]:
    """Limits that encoders bound: attribute, unit of its key, that unit per SI, and one count after the low-pass."""
    return [
        ("force_limit", "N", 1.0, one_count.force),
        ("contact_force", "N", 1.0, one_count.force),
        ("penetration_limit", "mm", 1e3, one_count.position),
        ("deflection_limit", "deg", math.degrees(1.0), one_count.wind_up),
        ("frozen_travel", "deg", math.degrees(1.0), one_count.wind_up),
        ("jump_limit", "rad_per_s", 1.0, one_count.jump),
        ("speed_limit", "mm_per_s", 1e3, share * one_count.velocity),
        ("force_rate_limit", "N_per_s", 1.0, share * one_count.force_rate),
        ("follow_limit", "rad_per_s", 1.0, share * one_count.motor_speed),
    ]


def _of_retraction(monitor: Monitor, belief: Belief) -> list[str]:
    """The retraction has to raise the platform from everywhere: looked at around the top and around the bottom."""
    geometry = Geometry(belief.a, belief.b, belief.l_a, belief.l_b)
    for z in (monitor.z_max, monitor.z_min):
        for angle in range(0, 360, 30):
            x = monitor.workspace_radius * math.cos(math.radians(angle))
            y = monitor.workspace_radius * math.sin(math.radians(angle))
            where = f"from ({1e3 * x:.0f}, {1e3 * y:.0f}, {1e3 * z:.0f}) mm"
            try:
                rises = retreat(geometry, belief.N, (x, y, z), monitor.retract).slowest > 0.0
            except Unreachable as problem:
                return [f"[monitor] the workspace or the retraction leaves the robot's reach {where}: {problem}"]
            if not rises:
                return [
                    f"[monitor] retract_deg = {math.degrees(monitor.retract):g} is longer than the workspace: {where} "
                    "the platform would sink again at the end; retract less or lower z_max_mm"
                ]
    return []
