"""What is said of a robot: what its controller knows of it, and what it truly is."""

from pydantic import Field, model_validator

from twin.experiment.quantity import Section, quantity

Triple = tuple[float, float, float]
ZEROS = (0.0, 0.0, 0.0)


class Model(Section):
    """What both the robot's maker and its controller know of a robot: Fig. 2, Eq. 18-20, the encoders."""

    a: float = quantity("a_mm", "radius of the base triangle, Fig. 2", gt=0)
    b: float = quantity("b_mm", "radius of the platform triangle, Fig. 2", gt=0)
    l_a: float = quantity("l_a_mm", "length of the proximal links, Fig. 2", gt=0)
    l_b: float = quantity("l_b_mm", "length of the distal links, Fig. 2", gt=0)
    m_a: float = quantity("m_a_g", "mass of one proximal link", ge=0)
    m_b: float = quantity("m_b_g", "mass of one distal rod pair", ge=0)
    m_p: float = quantity("m_p_g", "mass of the platform with its head", ge=0)
    k_s: float = quantity("k_s_Nm_per_rad", "stiffness of the series elastic spring, Eq. 18", gt=0)
    N: float = Field(gt=0, description="belt reduction, motor turns per joint turn")
    eta: float = Field(gt=0, le=1, description="efficiency of the belt, Eq. 18")
    motor_counts_per_turn: int = Field(gt=0, description="resolution of the motor encoders")
    joint_counts_per_turn: int = Field(gt=0, description="resolution of the joint encoders")
    motor_zero: Triple = quantity("motor_zero_deg", "angle at which each motor encoder reads zero")
    joint_zero: Triple = quantity("joint_zero_deg", "angle at which each joint encoder reads zero")


class Robot(Model):
    """[robot]: a robot as it is, with what its controller does not model."""

    name: str = Field(description="for people")
    I_r: float = quantity("I_r_kg_m2", "inertia of pulley and encoder about the joint axis", ge=0)
    b_j: float = quantity("b_j_Nm_s_per_rad", "viscous friction of a joint", ge=0)
    backlash: float = quantity("backlash_deg", "half width of the dead zone, motor side", ge=0)
    eta_rate: float = quantity(
        "eta_rate_rad_per_s", "speed over which eta turns from driven to driving; 0: it does not", ge=0
    )
    motor_noise: float = quantity("motor_noise_deg", "standard deviation of the motor encoders' noise", 0.0, ge=0)
    joint_noise: float = quantity("joint_noise_deg", "standard deviation of the joint encoders' noise", 0.0, ge=0)
    motor_eccentricity: Triple = quantity(
        "motor_eccentricity_deg", "how much each motor encoder reads too much at most, once a turn", ZEROS
    )
    motor_eccentric_at: Triple = quantity(
        "motor_eccentric_at_deg",
        "motor angle from which on that error grows, a quarter of a turn before it is most",
        ZEROS,
    )
    joint_eccentricity: Triple = quantity(
        "joint_eccentricity_deg", "how much each joint encoder reads too much at most, once a turn", ZEROS
    )
    joint_eccentric_at: Triple = quantity(
        "joint_eccentric_at_deg",
        "joint angle from which on that error grows, a quarter of a turn before it is most",
        ZEROS,
    )
    encoder_latency: float = quantity("encoder_latency_ms", "how old a count is when it is read", 0.0, ge=0, le=1000)
    belt_compliance: float = quantity(
        "belt_compliance_rad_per_Nm", "how far a joint turns by its belt alone, in series with the spring", 0.0, ge=0
    )
    joint_friction: float = quantity("joint_friction_Nm", "dry friction of a joint", 0.0, ge=0)
    joint_presliding: float = quantity(
        "joint_presliding_deg", "how far a joint yields before its dry friction slides", 0.05, gt=0
    )
    spring_hysteresis: float = Field(
        0.0, ge=0, le=0.5, description="share of a spring's torque that its own dry friction adds and takes"
    )
    spring_stop: float | None = quantity(
        "spring_stop_deg", "deflection at which a spring meets its hard stop, motor side", None, gt=0, examples=[15.0]
    )
    joint_lower: float | None = quantity("joint_lower_deg", "hard stop of a joint, upwards", None, examples=[-60.0])
    joint_upper: float | None = quantity("joint_upper_deg", "hard stop of a joint, downwards", None, examples=[90.0])
    stop: float = quantity("stop_Nm_per_rad", "stiffness of hard stops", 100.0, gt=0)
    mounting_tilt: float = quantity("mounting_tilt_deg", "tilt of the base about its y", 0.0, ge=-180, le=180)
    mounting_tilt_x: float = quantity("mounting_tilt_x_deg", "tilt of the base about its x", 0.0, ge=-180, le=180)
    head: Triple = quantity("head_mm", "where the head touches, seen from O_P", ZEROS)
    ball_joint_limit: float | None = quantity(
        "ball_joint_limit_deg",
        "how far a rod may lean in its ball joints; without it, any",
        None,
        gt=0,
        examples=[30.0],
    )
    link_diameter: float | None = quantity(
        "link_diameter_mm", "of the proximal links, which may not meet other legs", None, gt=0, examples=[9.0]
    )
    rod_diameter: float | None = quantity(
        "rod_diameter_mm", "of the distal rods, which may not meet other legs", None, gt=0, examples=[4.0]
    )
    rod_spacing: float | None = quantity(
        "rod_spacing_mm", "between the two rods of a pair", None, gt=0, examples=[24.0]
    )

    @model_validator(mode="after")
    def _in_order(self) -> "Robot":
        if self.joint_lower is not None and self.joint_upper is not None and self.joint_lower >= self.joint_upper:
            raise ValueError("joint_lower_deg: expected less than joint_upper_deg")
        return self


class Plant(Robot):
    """[plant]: [robot], where the real one differs from it; and how finely it is integrated."""

    substeps: int = Field(ge=1, le=1000, description="Runge-Kutta steps per tick")
