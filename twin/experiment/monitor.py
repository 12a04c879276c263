"""[monitor]: the safety monitor's limits. docs/safety.md argues each default."""

from pydantic import Field

from twin.experiment.quantity import Section, quantity


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
