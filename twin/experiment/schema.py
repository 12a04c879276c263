"""The tables of an experiment file. Keys carry units, attributes are SI (see `quantity.py`)."""

from typing import Literal

from pydantic import Field, model_validator

from twin.experiment.quantity import Section, quantity

Triple = tuple[float, float, float]


class Model(Section):
    """What both the robot's maker and its controller know of a robot: Fig. 2, Eq. 18-20, the encoders."""

    a: float = quantity("a_mm", gt=0, description="radius of the base triangle, Fig. 2")
    b: float = quantity("b_mm", gt=0, description="radius of the platform triangle, Fig. 2")
    l_a: float = quantity("l_a_mm", gt=0, description="length of the proximal links, Fig. 2")
    l_b: float = quantity("l_b_mm", gt=0, description="length of the distal links, Fig. 2")
    m_a: float = quantity("m_a_g", ge=0, description="mass of one proximal link")
    m_b: float = quantity("m_b_g", ge=0, description="mass of one distal rod pair")
    m_p: float = quantity("m_p_g", ge=0, description="mass of the platform with its head")
    k_s: float = quantity("k_s_Nm_per_rad", gt=0, description="stiffness of the series elastic spring, Eq. 18")
    N: float = Field(gt=0, description="belt reduction, motor turns per joint turn")
    eta: float = Field(gt=0, le=1, description="efficiency of the belt, Eq. 18")
    motor_counts_per_turn: int = Field(gt=0, description="resolution of the motor encoders")
    joint_counts_per_turn: int = Field(gt=0, description="resolution of the joint encoders")
    motor_zero: Triple = quantity("motor_zero_deg", description="angle at which each motor encoder reads zero")
    joint_zero: Triple = quantity("joint_zero_deg", description="angle at which each joint encoder reads zero")


class Robot(Model):
    """[robot]: a robot as it is, with what its controller does not model."""

    name: str = Field(description="for people")
    I_r: float = quantity("I_r_kg_m2", ge=0, description="inertia of pulley and encoder about the joint axis")
    b_j: float = quantity("b_j_Nm_s_per_rad", ge=0, description="viscous friction of a joint")
    backlash: float = quantity("backlash_deg", ge=0, description="half width of the dead zone, motor side")
    eta_rate: float = quantity(
        "eta_rate_rad_per_s", ge=0, description="speed over which eta turns from driven to driving; 0: it does not"
    )
    motor_noise: float = quantity(
        "motor_noise_deg", 0.0, ge=0, description="standard deviation of the motor encoders' noise"
    )
    joint_noise: float = quantity(
        "joint_noise_deg", 0.0, ge=0, description="standard deviation of the joint encoders' noise"
    )


class Plant(Robot):
    """[plant]: [robot], where the real one differs from it; and how finely it is integrated."""

    substeps: int = Field(ge=1, le=1000, description="Runge-Kutta steps per tick")


class Scale(Section):
    """[scale]: the electronic scale's display."""

    resolution: float = quantity("resolution_g", gt=0, description="smallest step of the display")
    period: float = quantity("period_ms", gt=0, description="time between two readings")


class Cosim(Section):
    """[cosim]: how the components are stepped."""

    tick: float = quantity("tick_ms", gt=0, description="step in which the components exchange their values")
    scheme: Literal["gauss_seidel", "jacobi"] = Field(
        description="whether plant and drives see each other's newest values, or all those of the tick before"
    )
    inputs: Literal["hold", "linear"] = Field(
        "hold", description="whether they see values of one end of the step, or a line between both ends"
    )
    iterations: int = Field(1, ge=1, le=100, description="how often plant and drives make each step")


class Recording(Section):
    """[recording]: how often the plant, the drives and whatever else has values every tick are recorded."""

    rate: Literal["tick", "controller"] = Field(
        default="tick", description="every tick, or once per period of the controller: half the file"
    )


class VelocityLoop(Section):
    """[drive.velocity_loop]: our discrete PI before a drive that takes no speed. Gains in the command's SI unit."""

    kp: float = Field(ge=0, examples=[0.08], description="gain, command per rad/s")
    ki: float = Field(0.0, ge=0, description="integral gain, command per rad")
    limit: float = Field(gt=0, examples=[0.6], description="largest command")
    period: float = quantity("period_ms", gt=0, examples=[0.25], description="time between two commands")


class Part(Section):
    """[drive.parts.NAME]: one FMU of a drive that is made of several."""

    fmu: str = Field(description="an .fmu file")
    sha256: str | None = Field(None, examples=["00000000..."], description="refuse any other file")
    parameters: dict[str, float] = Field(default_factory=dict, description="the FMU's own names and units")


class Drive(Section):
    """[drive], [drive.joint_1] ..: a drive. Names and units of variables and parameters are the FMU's own.

    Either `fmu`, or `parts` with `wires` between them; variables of parts are called "part.variable".
    """

    fmu: str | None = Field(None, examples=["fmus/pmsm_foc"], description="an .fmu file, or a folder of fmus/")
    sha256: str | None = Field(None, examples=["00000000..."], description="refuse any other file")
    command: Literal["velocity", "torque", "current", "voltage"] = Field(
        "velocity", description="what the drive takes; all but a velocity need a [drive.velocity_loop]"
    )
    sign: Literal[1, -1] = Field(1, description="-1: the FMU counts the other way round")
    gear_ratio: float = Field(1.0, gt=0, description="turns of the FMU's shaft per turn of the motor shaft")
    substeps: int = Field(1, ge=1, le=10_000, description="steps of the FMU per tick")
    inputs: dict[str, str] = Field(default_factory=dict, description="our name = the FMU's")
    outputs: dict[str, str] = Field(default_factory=dict, description="our name = the FMU's")
    parameters: dict[str, float] = Field(default_factory=dict, description="the FMU's own names and units")
    velocity_loop: VelocityLoop | None = None
    parts: dict[str, Part] = Field(default_factory=dict, description="FMUs of a drive that is made of several")
    wires: dict[str, str] = Field(default_factory=dict, description="between parts: part.input = part.output")

    @model_validator(mode="after")
    def _consistent(self) -> "Drive":
        if (self.fmu is None) == (not self.parts):
            raise ValueError('expected either fmu = "..." or [drive.parts.NAME] tables')
        if (self.command == "velocity") != (self.velocity_loop is None):
            raise ValueError(
                f'command = "{self.command}" '
                + ("takes no velocity_loop" if self.command == "velocity" else "needs a [drive.velocity_loop]")
            )
        return self


class PositionLoop(Section):
    """[controller.position]: PID from position error (m) to platform speed (m/s), the same on x, y and z."""

    kp: float = quantity("kp_per_s", ge=0, le=1000, description="platform speed per position error")
    ki: float = quantity("ki_per_s2", 0.0, ge=0, description="integral gain")
    kd: float = Field(0.0, ge=0, description="derivative gain")
    derivative_filter: float = quantity(
        "derivative_filter_Hz", 0.0, ge=0, description="low-pass of the derivative; 0: none"
    )


class ForceLoop(Section):
    """[controller.force]: PID from force error (N) to a shift of the z reference (m), and what starts it."""

    reference: float | None = quantity(
        "reference_N", None, gt=0, le=50, examples=[5.0], description="pressing force to hold"
    )
    trigger: float | None = quantity(
        "trigger_N", None, ge=0, examples=[0.6], description="pressing force that starts the force loop"
    )
    trigger_time: float | None = quantity(
        "trigger_time_s", None, ge=0, examples=[6.0], description="when the force loop starts, whatever the force"
    )
    kp: float = quantity("kp_mm_per_N", ge=0, le=1000, description="shift of the z reference per force error")
    ki: float = quantity("ki_mm_per_N_s", ge=0, le=10_000, description="integral gain")
    kd: float = quantity("kd_mm_s_per_N", 0.0, ge=0, description="derivative gain")
    derivative_filter: float = quantity(
        "derivative_filter_Hz", 0.0, ge=0, description="low-pass of the derivative; 0: none"
    )
    limit: float = quantity("limit_mm", gt=0, description="largest shift of the z reference")
    filter: float = quantity("filter_Hz", ge=0, description="low-pass of the estimated force; 0: none")


class Touch(Section):
    """[controller.touch]: how the controller feels contact in a task."""

    contact: float = quantity("contact_N", gt=0, description="pressing force that counts as touching")
    patience: float = quantity("patience_ms", gt=0, description="how long contact may be lost while pressing")
    turn: float = quantity(
        "turn_ms", ge=0, le=100, description="how long before its lowest point the first tap turns round"
    )
    learning: float = Field(ge=0, le=1, description="share of a tap's depth error that the next one corrects")


class FeedForward(Section):
    """[controller.feed_forward]: what the controller believes of the drives' lag and the friction under the head."""

    lag: float = quantity("lag_ms", ge=0, description="believed lag of the drives")
    friction: float = Field(ge=0, description="believed friction under the head")


class Damping(Section):
    """[controller.damping]: how the motors give way to swings of the springs' torque."""

    gain: float = quantity("gain_rad_per_s_per_Nm", ge=0, description="motor speed per torque of the spring")
    corner: float = quantity("corner_Hz", gt=0, description="swings slower than this are not damped")


class Controller(Section):
    """[controller]: the robot's computer. `touch`, `feed_forward` and `damping` belong to tasks."""

    mode: Literal["force_position", "position"] = Field(description="force and position, or position alone")
    period: float = quantity("period_ms", gt=0, description="time between two commands")
    delay_ticks: int = Field(0, ge=0, le=1000, description="computation delay")
    speed_limit: float = quantity("speed_limit_rad_per_s", gt=0, description="largest motor speed it commands")
    gravity_compensation: bool = Field(description="take the robot's own weight out of the estimated force")
    dead_zone: float = quantity(
        "dead_zone_deg",
        0.0,
        ge=0,
        description="believed half width of the backlash, which the estimator takes off; 0: the paper's estimator",
    )
    position: PositionLoop
    force: ForceLoop
    touch: Touch | None = None
    feed_forward: FeedForward | None = None
    damping: Damping | None = None
    model: Model
