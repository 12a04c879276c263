"""What the monitor tolerates, and how it retracts."""

from twin.cosim.record import record_of
from twin.settings import Settings, Values, setting, taken


class Monitor(Settings):
    """[monitor]: a table without keys is complete. The defaults suit a massage at 3 to 8 N.

    A command counts as saturated at `command_limit`, by default the controller's own limit.
    """

    enabled: bool = setting(default=True, help="false: nobody watches")
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
    deflection_limit: float = setting("deg", default=20.0, gt=0, help="spring wind-up that trips")
    jump_limit: float = setting(
        "rad/s", default=25.0, gt=0, help="change of a spring's wind-up that no motion explains"
    )
    stale_time: float = setting("ms", default=10.0, gt=0, help="time without a new encoder message that trips")
    frozen_demand: float = setting("rad/s", default=0.5, gt=0, help="commanded speed at which a shaft has to move")
    frozen_time: float = setting("ms", default=100.0, gt=0, help="time for which it may stand still")
    frozen_travel: float = setting("deg", default=8.0, gt=0, help="commanded travel without a count that trips")
    command_limit: float | None = setting(
        "rad/s",
        default=None,
        gt=0,
        examples=[8.0],
        help="command that counts as saturated; without it the controller's own limit",
    )
    saturation_time: float = setting("ms", default=500.0, gt=0, help="time of a saturated command that trips")
    follow_limit: float = setting(
        "rad/s", default=1.5, gt=0, help="difference of commanded and measured motor speed that trips"
    )
    follow_time: float = setting("ms", default=150.0, gt=0, help="time for which it has to last")
    filter: float = setting("Hz", default=20.0, gt=0, help="low-pass of speeds and rates")
    retract: float = setting("deg", default=30.0, gt=0, help="how far a trip turns the motors back")
    retract_speed: float = setting("rad/s", default=2.0, gt=0, help="how fast")


class Limits(Values, parts=(taken(Monitor),)):
    """Limits of the monitor, SI, and how it retracts.

    A check trips when its limit is reached; a contact ends at half of the force at which it begins. docs/safety.md says
    what each is for.
    """


LIMITS = record_of(Limits)
