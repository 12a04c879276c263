"""The tables of an experiment file. Keys carry units, attributes are SI (see `quantity.py`)."""

from itertools import pairwise
from typing import Literal

from pydantic import Field, field_validator, model_validator

from twin.experiment.quantity import Section, quantity

Triple = tuple[float, float, float]


class Model(Section):
    """What both the robot's maker and its controller know of a robot: Fig. 2, Eq. 18-20, the encoders."""

    a: float = quantity("a_mm", gt=0)
    b: float = quantity("b_mm", gt=0)
    l_a: float = quantity("l_a_mm", gt=0)
    l_b: float = quantity("l_b_mm", gt=0)
    m_a: float = quantity("m_a_g", ge=0)
    m_b: float = quantity("m_b_g", ge=0)
    m_p: float = quantity("m_p_g", ge=0)
    k_s: float = quantity("k_s_Nm_per_rad", gt=0)
    N: float = Field(gt=0)
    eta: float = Field(gt=0, le=1)
    motor_counts_per_turn: int = Field(gt=0)
    joint_counts_per_turn: int = Field(gt=0)
    motor_zero: Triple = quantity("motor_zero_deg")
    joint_zero: Triple = quantity("joint_zero_deg")


class Robot(Model):
    """[robot]: a robot as it is, with what its controller does not model."""

    name: str
    I_r: float = quantity("I_r_kg_m2", ge=0)
    b_j: float = quantity("b_j_Nm_s_per_rad", ge=0)
    backlash: float = quantity("backlash_deg", ge=0)
    eta_rate: float = quantity("eta_rate_rad_per_s", ge=0)
    motor_noise: float = quantity("motor_noise_deg", 0.0, ge=0)
    joint_noise: float = quantity("joint_noise_deg", 0.0, ge=0)


class Plant(Robot):
    """[plant]: [robot], where the real one differs from it; and how finely it is integrated."""

    substeps: int = Field(ge=1, le=1000)


class Scale(Section):
    """[scale]: the electronic scale's display."""

    resolution: float = quantity("resolution_g", gt=0)
    period: float = quantity("period_ms", gt=0)


class Cosim(Section):
    """[cosim]: how the components are stepped."""

    tick: float = quantity("tick_ms", gt=0)
    scheme: Literal["gauss_seidel", "jacobi"]
    inputs: Literal["hold", "linear"] = "hold"
    iterations: int = Field(1, ge=1, le=100)


class VelocityLoop(Section):
    """[drive.velocity_loop]: our discrete PI before a drive that takes no speed. Gains in the command's SI unit."""

    kp: float = Field(ge=0)
    ki: float = Field(0.0, ge=0)
    limit: float = Field(gt=0)
    period: float = quantity("period_ms", gt=0)


class Part(Section):
    """[drive.parts.NAME]: one FMU of a drive that is made of several."""

    fmu: str
    sha256: str | None = None
    parameters: dict[str, float] = Field(default_factory=dict)


class Drive(Section):
    """[drive], [drive.joint_1] ..: a drive. Names and units of variables and parameters are the FMU's own.

    Either `fmu`, or `parts` with `wires` between them; variables of parts are called "part.variable".
    """

    fmu: str | None = None
    sha256: str | None = None
    command: Literal["velocity", "torque", "current", "voltage"] = "velocity"
    sign: Literal[1, -1] = 1
    gear_ratio: float = Field(1.0, gt=0)
    substeps: int = Field(1, ge=1, le=10_000)
    inputs: dict[str, str] = Field(default_factory=dict)
    outputs: dict[str, str] = Field(default_factory=dict)
    parameters: dict[str, float] = Field(default_factory=dict)
    velocity_loop: VelocityLoop | None = None
    parts: dict[str, Part] = Field(default_factory=dict)
    wires: dict[str, str] = Field(default_factory=dict)

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

    kp: float = quantity("kp_per_s", ge=0)
    ki: float = quantity("ki_per_s2", 0.0, ge=0)
    kd: float = Field(0.0, ge=0)
    derivative_filter: float = quantity("derivative_filter_Hz", 0.0, ge=0)


class ForceLoop(Section):
    """[controller.force]: PID from force error (N) to a shift of the z reference (m), and what starts it."""

    reference: float | None = quantity("reference_N", None, gt=0)
    trigger: float | None = quantity("trigger_N", None, ge=0)
    trigger_time: float | None = quantity("trigger_time_s", None, ge=0)
    kp: float = quantity("kp_mm_per_N", ge=0)
    ki: float = quantity("ki_mm_per_N_s", ge=0)
    kd: float = quantity("kd_mm_s_per_N", 0.0, ge=0)
    derivative_filter: float = quantity("derivative_filter_Hz", 0.0, ge=0)
    limit: float = quantity("limit_mm", gt=0)
    filter: float = quantity("filter_Hz", ge=0)


class Touch(Section):
    """[controller.touch]: how the controller feels contact in a task."""

    contact: float = quantity("contact_N", gt=0)
    patience: float = quantity("patience_ms", gt=0)
    turn: float = quantity("turn_ms", ge=0, le=100)
    learning: float = Field(ge=0, le=1)


class FeedForward(Section):
    """[controller.feed_forward]: what the controller believes of the drives' lag and the friction under the head."""

    lag: float = quantity("lag_ms", ge=0)
    friction: float = Field(ge=0)


class Damping(Section):
    """[controller.damping]: how the motors give way to swings of the springs' torque."""

    gain: float = quantity("gain_rad_per_s_per_Nm", ge=0)
    corner: float = quantity("corner_Hz", gt=0)


class Controller(Section):
    """[controller]: the robot's computer. `touch`, `feed_forward` and `damping` belong to tasks."""

    mode: Literal["force_position", "position"]
    period: float = quantity("period_ms", gt=0)
    delay_ticks: int = Field(0, ge=0, le=1000)
    speed_limit: float = quantity("speed_limit_rad_per_s", gt=0)
    gravity_compensation: bool
    dead_zone: float = quantity("dead_zone_deg", 0.0, ge=0)
    position: PositionLoop
    force: ForceLoop
    touch: Touch | None = None
    feed_forward: FeedForward | None = None
    damping: Damping | None = None
    model: Model


class Reference(Section):
    """[reference]: way points, straight lines at constant speed between them."""

    t: tuple[float, ...] = quantity("t_s", min_length=1)
    p: tuple[Triple, ...] = quantity("p_mm", min_length=1)

    @field_validator("t")
    @classmethod
    def _ascending(cls, t: tuple[float, ...]) -> tuple[float, ...]:
        if any(later <= earlier for earlier, later in pairwise(t)):
            raise ValueError("expected times that increase from one way point to the next")
        return t
