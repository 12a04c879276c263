"""Limits of the safety monitor and parameters of its retraction: the keys of [monitor]."""

from typing import Literal

from twin.kernel.cosim.port import record_of
from twin.kernel.settings import Settings, Values, optional, setting, setting_fields


class Monitor(Settings):
    """Safety monitor settings, the table [monitor]; every key has a default. The defaults suit a massage at 3 to 8 N.

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


class Limits(Values, parts=(setting_fields(Monitor),)):
    """Limits of the safety monitor and parameters of its retraction, SI.

    A check trips when its limit is reached; a contact ends at half of its initial force. docs/safety.md has the
    purpose of each.
    """


LIMITS_RECORD = record_of(Limits)
