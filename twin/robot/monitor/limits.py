"""Limits of the safety monitor and parameters of its retraction: the keys of [monitor]."""

from typing import Literal

from twin.kernel.cosim.port import record_of
from twin.kernel.settings import Settings, Values, optional, setting, setting_fields


class Monitor(Settings):
    """Safety monitor settings, the table [monitor]; every key has a default. The defaults suit a massage at 3 to 8 N.

    A command counts as saturated at `command_limit`, by default the controller's own limit.
    """

    enabled: bool = setting(default=True, help="false switches the monitor off")
    period: float = setting("ms", into=None, default=2.0, gt=0, help="time between two evaluations")
    force_limit: float = setting("N", default=15.0, gt=0, help="limit of the length of the force, in any direction")
    force_rate_limit: float = setting("N/s", default=300.0, gt=0, help="limit of the growth of that length")
    contact_force: float = setting("N", default=1.0, gt=0, help="pressing force that counts as contact")
    penetration_limit: float = setting("mm", default=25.0, gt=0, help="limit of the depth below the first contact")
    contact_time_limit: float = setting("s", default=120.0, gt=0, help="limit of the duration of an unbroken contact")
    speed_limit: float = setting("mm/s", default=250.0, gt=0, help="limit of the platform's speed")
    workspace_radius: float = setting("mm", default=40.0, gt=0, help="limit of the distance from the z axis")
    z_min: float = setting("mm", default=-135.0, lt=0, help="lowest permitted z of the platform")
    z_max: float = setting("mm", default=-75.0, lt=0, help="highest permitted z of the platform")
    deflection_limit: float = setting("deg", default=20.0, gt=0, help="limit of a spring's deflection, motor side")
    jump_limit: float = setting(
        "rad/s", default=25.0, gt=0, help="limit of the speed of a deflection's change between two samples"
    )
    stale_time: float = setting("ms", default=10.0, gt=0, help="limit of the age of the last new sample")
    frozen_demand: float = setting("rad/s", default=0.5, gt=0, help="commanded speed that must move a motor encoder")
    frozen_time: float = setting("ms", default=100.0, gt=0, help="time within which that motor encoder has to move")
    frozen_travel: float = setting("deg", default=8.0, gt=0, help="commanded travel that must move a joint encoder")
    command_limit: float | None = optional(
        "rad/s", gt=0, example=8.0, help="command that counts as saturated; without it, the controller's limit"
    )
    saturation_time: float = setting("ms", default=500.0, gt=0, help="duration of a saturated command that trips")
    follow_limit: float = setting(
        "rad/s", default=1.5, gt=0, help="limit of the difference between commanded and measured motor speed"
    )
    follow_time: float = setting("ms", default=150.0, gt=0, help="duration of that difference that trips")
    drive_droop: float | None = optional(
        "rad/s/(N m)", gt=0, absent=0.0, example=0.6, help="believed droop; without it, hidden forces are not checked"
    )
    drive_lag: float = setting("ms", default=0.0, ge=0, help="believed time constant of the drives' speed")
    hidden_force_limit: float = setting(
        "N", default=8.0, gt=0, help="limit of the pressing force that the motors reveal and the encoders do not show"
    )
    hidden_time: float = setting("ms", default=500.0, gt=0, help="duration of that force that trips")
    filter: float = setting("Hz", default=20.0, gt=0, help="low-pass corner of force and speeds")
    retract: float = setting("deg", default=30.0, gt=0, help="motor angle of the retraction")
    retract_speed: float = setting("rad/s", default=2.0, gt=0, help="motor speed of the retraction")
    disobeyed: Literal["wait", "cut"] = setting(
        default="cut", help="power of drives that do not follow the retraction: cut at once, or after follow_time_ms"
    )
    obey_delay: float = setting("ms", default=10.0, ge=0, help="time after a trip before a drive has to turn back")
    obey_lag: float = setting("ms", default=100.0, gt=0, help="time constant of the slowest drive that obeys")
    release_time: float = setting(
        "ms", default=1000.0, ge=0, help="longest time without power that a brake with a line of its own stays open"
    )


class Limits(Values, parts=(setting_fields(Monitor),)):
    """Limits of the safety monitor and parameters of its retraction, SI.

    A check trips when its limit is reached; a contact ends at half of its initial force. docs/safety.md has the
    purpose of each.
    """


LIMITS_RECORD = record_of(Limits)
