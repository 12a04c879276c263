"""Every constant of the plant, SI."""

import math

from pydantic import model_validator

from twin.cosim.port import record_of
from twin.plant.contact_law import Contact
from twin.robot.model import Model
from twin.settings import Triple, Values, setting, taken

ZEROS = (0.0, 0.0, 0.0)


class Robot(Model):
    """[robot]: a robot as it is, with what its controller does not model."""

    name: str = setting(help="for people")
    I_r: float = setting("kg m2", ge=0, help="inertia of pulley and encoder about the joint axis")
    b_j: float = setting("N m s/rad", ge=0, help="viscous friction of a joint")
    backlash: float = setting("deg", ge=0, help="half width of the dead zone, motor side")
    eta_rate: float = setting("rad/s", ge=0, help="speed over which eta turns from driven to driving; 0: it does not")
    motor_noise: float = setting(
        "deg", into="encoders", default=0.0, ge=0, help="standard deviation of the motor encoders' noise"
    )
    joint_noise: float = setting(
        "deg", into="encoders", default=0.0, ge=0, help="standard deviation of the joint encoders' noise"
    )
    motor_eccentricity: Triple = setting(
        "deg", into="encoders", default=ZEROS, help="how much each motor encoder reads too much at most, once a turn"
    )
    motor_eccentric_at: Triple = setting(
        "deg",
        into="encoders",
        default=ZEROS,
        help="motor angle from which on that error grows, a quarter of a turn before it is most",
    )
    joint_eccentricity: Triple = setting(
        "deg", into="encoders", default=ZEROS, help="how much each joint encoder reads too much at most, once a turn"
    )
    joint_eccentric_at: Triple = setting(
        "deg",
        into="encoders",
        default=ZEROS,
        help="joint angle from which on that error grows, a quarter of a turn before it is most",
    )
    encoder_latency: float = setting(
        "ms", into=None, default=0.0, ge=0, le=1000, help="how old a count is when it is read"
    )
    belt_compliance: float = setting(
        "rad/(N m)", default=0.0, ge=0, help="how far a joint turns by its belt alone, in series with the spring"
    )
    joint_friction: float = setting("N m", default=0.0, ge=0, help="dry friction of a joint")
    joint_presliding: float = setting(
        "deg", default=0.05, gt=0, help="how far a joint yields before its dry friction slides"
    )
    spring_hysteresis: float = setting(
        default=0.0, ge=0, le=0.5, help="share of a spring's torque that its own dry friction adds and takes"
    )
    spring_stop: float | None = setting(
        "deg",
        absent=math.inf,
        default=None,
        gt=0,
        examples=[15.0],
        help="deflection at which a spring meets its hard stop, motor side",
    )
    joint_lower: float | None = setting(
        "deg", absent=-math.inf, default=None, examples=[-60.0], help="hard stop of a joint, upwards"
    )
    joint_upper: float | None = setting(
        "deg", absent=math.inf, default=None, examples=[90.0], help="hard stop of a joint, downwards"
    )
    stop: float = setting("N m/rad", default=100.0, gt=0, help="stiffness of hard stops")
    mounting_tilt: float = setting("deg", default=0.0, ge=-180, le=180, help="tilt of the base about its y")
    mounting_tilt_x: float = setting("deg", default=0.0, ge=-180, le=180, help="tilt of the base about its x")
    head: Triple = setting("mm", default=ZEROS, help="where the head touches, seen from O_P")
    ball_joint_limit: float | None = setting(
        "deg",
        into=None,
        default=None,
        gt=0,
        examples=[30.0],
        help="how far a rod may lean in its ball joints; without it, any",
    )
    link_diameter: float | None = setting(
        "mm", into=None, default=None, gt=0, examples=[9.0], help="of the proximal links, which may not meet other legs"
    )
    rod_diameter: float | None = setting(
        "mm", into=None, default=None, gt=0, examples=[4.0], help="of the distal rods, which may not meet other legs"
    )
    rod_spacing: float | None = setting(
        "mm", into=None, default=None, gt=0, examples=[24.0], help="between the two rods of a pair"
    )

    @model_validator(mode="after")
    def _in_order(self) -> "Robot":
        if self.joint_lower is not None and self.joint_upper is not None and self.joint_lower >= self.joint_upper:
            raise ValueError("joint_lower_deg: expected less than joint_upper_deg")
        return self


class TrueRobot(Robot):
    """[plant]: [robot], where the real one differs from it; and how finely it is integrated."""

    substeps: int = setting(into=None, ge=1, le=1000, help="Runge-Kutta steps per tick")


WHOLE = (1.0, 1.0, 1.0)
CONDITION = {
    "k_s_share": setting(
        default=WHOLE,
        broken_by=("spring_softened", "spring_broken"),
        help="what is left of k_s in the spring; 0: broken",
    ),
    "backlash_added": setting("rad", default=ZEROS, broken_by=("backlash_growth",), help="on top of backlash"),
    "b_j_added": setting("N m s/rad", default=ZEROS, broken_by=("joint_friction",), help="on top of b_j"),
    "slip": setting(
        "rad", default=ZEROS, broken_by=("belt_slip",), help="how far the belt has slipped: deflection lost, motor side"
    ),
}
"""Of each joint; in the beginning it is as it was built."""


class PlantParameters(
    Values,
    parts=(taken(TrueRobot), taken(Contact), CONDITION),
    # the oldest ones; whatever a table has besides follows
    first="""a b l_a l_b m_a m_b m_p I_r b_j k_s N eta backlash eta_rate z_s tilt K damping mu sigma_0 sigma_1 tilt_x
    shape radius law exponent reference_depth stiffening damper touch_depth k_s_share backlash_added b_j_added slip""",
):
    """The robot and what it presses on, as they really are (not as the controller believes), SI.

    Every number of [plant] and [contact] by its name there, but for `z_s`, the height, `K`, the stiffness, `mu`, the
    friction, and `sigma_0` and `sigma_1`, the bristle's stiffness and damping (see `contact_law.py`, `friction.py`,
    `surface.py`, `mounting.py`), and the CONDITION of each joint. What a table may leave out is a robot without that
    effect: `eta_rate` 0, the paper's constant efficiency, and hard stops at infinity.
    """


PARAMETERS = record_of(PlantParameters)
"""`PlantParameters` as a record: numbers, and arrays (3,) where the tuple holds three."""

STATES = 8
"""The state x: platform position p_B (m), velocity v_B (m/s), bristle deflection z_b in the surface (m)."""
