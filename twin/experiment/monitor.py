"""[monitor]: the safety monitor's limits. docs/safety.md argues each default."""

from pydantic import Field

from twin.experiment.quantity import Section, quantity


class Monitor(Section):
    """[monitor]: a table without keys is complete. The defaults suit a massage at 3 to 8 N.

    A command counts as saturated at `command_limit`, by default the controller's own limit.
    """

    enabled: bool = Field(default=True, description="false: nobody watches")
    period: float = quantity("period_ms", "time between two looks", 2.0, gt=0)
    force_limit: float = quantity("force_limit_N", "length of the force, in any direction, that trips", 15.0, gt=0)
    force_rate_limit: float = quantity("force_rate_limit_N_per_s", "force rate that trips", 300.0, gt=0)
    contact_force: float = quantity("contact_force_N", "force that counts as contact", 1.0, gt=0)
    penetration_limit: float = quantity("penetration_limit_mm", "depth below first contact that trips", 25.0, gt=0)
    contact_time_limit: float = quantity("contact_time_limit_s", "contact without a break that trips", 120.0, gt=0)
    speed_limit: float = quantity("speed_limit_mm_per_s", "platform speed that trips", 250.0, gt=0)
    workspace_radius: float = quantity("workspace_radius_mm", "distance from the z axis that trips", 40.0, gt=0)
    z_min: float = quantity("z_min_mm", "lowest z", -135.0, lt=0)
    z_max: float = quantity("z_max_mm", "highest z", -75.0, lt=0)
    deflection_limit: float = quantity("deflection_limit_deg", "spring wind-up that trips", 20.0, gt=0)
    jump_limit: float = quantity(
        "jump_limit_rad_per_s", "change of a spring's wind-up that no motion explains", 25.0, gt=0
    )
    stale_time: float = quantity("stale_time_ms", "time without a new encoder message that trips", 10.0, gt=0)
    frozen_demand: float = quantity(
        "frozen_demand_rad_per_s", "commanded speed at which a shaft has to move", 0.5, gt=0
    )
    frozen_time: float = quantity("frozen_time_ms", "time for which it may stand still", 100.0, gt=0)
    frozen_travel: float = quantity("frozen_travel_deg", "commanded travel without a count that trips", 8.0, gt=0)
    command_limit: float | None = quantity(
        "command_limit_rad_per_s",
        "command that counts as saturated; without it the controller's own limit",
        None,
        gt=0,
        examples=[8.0],
    )
    saturation_time: float = quantity("saturation_time_ms", "time of a saturated command that trips", 500.0, gt=0)
    follow_limit: float = quantity(
        "follow_limit_rad_per_s", "difference of commanded and measured motor speed that trips", 1.5, gt=0
    )
    follow_time: float = quantity("follow_time_ms", "time for which it has to last", 150.0, gt=0)
    filter: float = quantity("filter_Hz", "low-pass of speeds and rates", 20.0, gt=0)
    retract: float = quantity("retract_deg", "how far a trip turns the motors back", 30.0, gt=0)
    retract_speed: float = quantity("retract_speed_rad_per_s", "how fast", 2.0, gt=0)
