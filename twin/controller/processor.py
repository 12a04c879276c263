"""What the robot's computer is besides its loops: period, delays, the largest command, what it knows of the robot."""

from typing import Literal

from twin.settings import Settings, setting


class Processor(Settings):
    """The keys of [controller] itself."""

    mode: Literal["force_position", "position"] = setting(help="force and position, or position alone")
    period: float = setting("ms", gt=0, help="time between two commands")
    delay_ticks: int = setting(default=0, ge=0, le=1000, help="computation delay")
    bus_delay_ticks: int = setting(default=0, ge=0, le=1000, help="delay of the bus to the drives, behind the monitor")
    speed_limit: float = setting("rad/s", gt=0, field="omega_max", help="largest motor speed it commands")
    gravity_compensation: bool = setting(help="take the robot's own weight out of the estimated force")
    dead_zone: float = setting(
        "deg",
        default=0.0,
        ge=0,
        field="backlash",
        help="believed half width of the backlash, which the estimator takes off; 0: the paper's estimator",
    )
