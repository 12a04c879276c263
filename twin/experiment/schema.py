"""The tables of an experiment file. Keys carry units, attributes are SI (see `quantity.py`)."""

import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from twin.experiment.quantity import Section, quantity
from twin.experiment.robot import Model
from twin.experiment.tissue import Breath, ScheduledGains, Tissue, order_refused


class Scale(Section):
    """[scale]: the electronic scale's display."""

    resolution: float = quantity("resolution_g", "smallest step of the display", gt=0)
    period: float = quantity("period_ms", "time between two readings", gt=0)


class Cosim(Section):
    """[cosim]: how the components are stepped."""

    tick: float = quantity("tick_ms", "step in which the components exchange their values", gt=0)
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
    period: float = quantity("period_ms", "time between two commands", gt=0, examples=[0.25])


class PositionCommand(Section):
    """[drive.position_command]: how a servo that takes a position is told it; angles as the servo counts its own."""

    period: float | None = quantity(
        "period_ms", "time between two commands; else one per tick", None, gt=0, examples=[1.0]
    )
    lower: float | None = quantity("lower_deg", "smallest angle that it takes", None, examples=[-150.0])
    upper: float | None = quantity("upper_deg", "largest angle that it takes", None, examples=[150.0])
    wrap_from: float | None = quantity(
        "wrap_from_deg", "it counts its angle from here over one turn only", None, examples=[-180.0]
    )
    lead: float | None = quantity(
        "lead_deg", "most by which the command is ahead of the robot's motor shaft", None, gt=0, examples=[20.0]
    )

    @model_validator(mode="after")
    def _in_order(self) -> "PositionCommand":
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise ValueError("lower_deg: expected less than upper_deg")
        return self


class Rotor(Section):
    """[drive.rotor]: a shaft of ours behind an FMU that gives a torque, felt at the robot's motor shaft."""

    J: float = quantity("J_kg_m2", "inertia", gt=0, examples=[1e-4])
    b: float = quantity("b_Nm_s_per_rad", "viscous friction", 0.0, ge=0)


def _of_one_kind(value: Any) -> Any:
    """`value`, if it can be that of a parameter: else pydantic would say of each kind why it is not that one."""
    many = isinstance(value, (list, tuple))
    values = tuple(value) if many else (value,)
    kinds = {str if isinstance(v, str) else float if type(v) in (int, float) else None for v in values}
    if len(kinds) != 1 or None in kinds:
        raise PydanticCustomError("parameter_type", "no parameter")
    if kinds == {float} and not all(math.isfinite(v) for v in values):
        raise PydanticCustomError("finite_number", "no finite number")
    return values if many else value


Parameter = Annotated[float | str | tuple[float, ...] | tuple[str, ...], BeforeValidator(_of_one_kind)]
PARAMETERS = 'the FMU\'s own names and units; values of enumerations by name, text, arrays, files as "file:NAME"'


TOLERANCE = "relative, of the solver, the FMU's own or ours for model exchange; without it, what the FMU states"


Kind = Literal["co_simulation", "model_exchange"]
KIND = "as which the FMU is used; without it, co-simulation if it offers that"
Method = Literal["cvode", "rk4"]
METHOD = "of model exchange: holds the tolerance, or goes in steps of one length; without it, cvode"
SOLVER_STEP = "longest step of rk4; without it, one per step of the drive"


class Part(Section):
    """[drive.parts.NAME]: one FMU of a drive that is made of several."""

    fmu: str = Field(description="an .fmu file")
    sha256: str | None = Field(None, examples=["00000000..."], description="refuse any other file")
    parameters: dict[str, Parameter] = Field(default_factory=dict, description=PARAMETERS)
    tolerance: float | None = Field(None, gt=0, examples=[1e-9], description=TOLERANCE)
    kind: Kind | None = Field(None, examples=["model_exchange"], description=KIND)
    solver: Method | None = Field(None, examples=["rk4"], description=METHOD)
    solver_step: float | None = quantity("solver_step_ms", SOLVER_STEP, None, gt=0, examples=[0.1])


class Drive(Section):
    """[drive], [drive.joint_1] ..: a drive. Names and units of variables and parameters are the FMU's own.

    Either `fmu`, or `parts` with `wires` between them; variables of parts are called "part.variable".
    """

    fmu: str | None = Field(None, examples=["fmus/pmsm_foc"], description="an .fmu file, or a folder of fmus/")
    sha256: str | None = Field(None, examples=["00000000..."], description="refuse any other file")
    command: Literal["velocity", "torque", "current", "voltage", "position"] = Field(
        "velocity", description="what the drive takes; torque, current and voltage need a [drive.velocity_loop]"
    )
    sign: Literal[1, -1] = Field(1, description="-1: the FMU counts the other way round")
    gear_ratio: float = Field(1.0, gt=0, description="turns of the FMU's shaft per turn of the motor shaft")
    substeps: int = Field(1, ge=1, le=10_000, description="steps of the FMU per tick")
    inputs: dict[str, str] = Field(default_factory=dict, description="our name = the FMU's")
    outputs: dict[str, str] = Field(default_factory=dict, description="our name = the FMU's")
    parameters: dict[str, Parameter] = Field(default_factory=dict, description=PARAMETERS)
    tolerance: float | None = Field(None, gt=0, examples=[1e-9], description=TOLERANCE)
    kind: Kind | None = Field(None, examples=["model_exchange"], description=KIND)
    solver: Method | None = Field(None, examples=["rk4"], description=METHOD)
    solver_step: float | None = quantity("solver_step_ms", SOLVER_STEP, None, gt=0, examples=[0.1])
    velocity_loop: VelocityLoop | None = None
    position_command: PositionCommand | None = None
    rotor: Rotor | None = None
    parts: dict[str, Part] = Field(default_factory=dict, description="FMUs of a drive that is made of several")
    wires: dict[str, str] = Field(default_factory=dict, description="between parts: part.input = part.output")

    @model_validator(mode="after")
    def _consistent(self) -> "Drive":
        if (self.fmu is None) == (not self.parts):
            raise ValueError('expected either fmu = "..." or [drive.parts.NAME] tables')
        takes_motion = self.command in ("velocity", "position")
        if takes_motion != (self.velocity_loop is None):
            raise ValueError(
                f'command = "{self.command}" '
                + ("takes no velocity_loop" if takes_motion else "needs a [drive.velocity_loop]")
            )
        if self.position_command and self.command != "position":
            raise ValueError(f'command = "{self.command}" takes no position_command')
        for method, step in [
            (self.solver, self.solver_step),
            *((p.solver, p.solver_step) for p in self.parts.values()),
        ]:
            if step is not None and "rk4" not in (method, self.solver):
                raise ValueError('solver_step_ms is of solver = "rk4"; say that, or remove it')
        return self


class PositionLoop(Section):
    """[controller.position]: PID from position error (m) to platform speed (m/s), the same on x, y and z."""

    kp: float = quantity("kp_per_s", "platform speed per position error", ge=0, le=1000)
    ki: float = quantity("ki_per_s2", "integral gain", 0.0, ge=0)
    kd: float = Field(0.0, ge=0, description="derivative gain")
    derivative_filter: float = quantity("derivative_filter_Hz", "low-pass of the derivative; 0: none", 0.0, ge=0)


class ForceLoop(Section):
    """[controller.force]: PID from force error (N) to a shift of the z reference (m), and what starts it."""

    reference: float | None = quantity("reference_N", "pressing force to hold", None, gt=0, le=50, examples=[5.0])
    trigger: float | None = quantity(
        "trigger_N", "pressing force that starts the force loop", None, ge=0, examples=[0.6]
    )
    trigger_time: float | None = quantity(
        "trigger_time_s", "when the force loop starts, whatever the force", None, ge=0, examples=[6.0]
    )
    kp: float = quantity("kp_mm_per_N", "shift of the z reference per force error", ge=0, le=1000)
    ki: float = quantity("ki_mm_per_N_s", "integral gain", ge=0, le=10_000)
    kd: float = quantity("kd_mm_s_per_N", "derivative gain", 0.0, ge=0)
    derivative_filter: float = quantity("derivative_filter_Hz", "low-pass of the derivative; 0: none", 0.0, ge=0)
    limit: float = quantity("limit_mm", "largest shift of the z reference", gt=0)
    filter: float = quantity("filter_Hz", "low-pass of the estimated force; 0: none", ge=0)
    schedule: tuple[ScheduledGains, ...] = Field(
        (),
        description="gains over the stiffness that [controller.tissue] estimates, softest first; without it, these",
        examples=[[
            {"stiffness_N_per_m": 600.0, "kp_mm_per_N": 2.0, "ki_mm_per_N_s": 30.0},
            {"stiffness_N_per_m": 1200.0, "kp_mm_per_N": 1.5, "ki_mm_per_N_s": 15.0},
        ]],
    )  # fmt: skip
    follow: float = Field(
        1.0, ge=0, le=1, description="with a schedule: share of a change of the reference that is fed forward"
    )
    rate: float = quantity("rate_per_s", "with a schedule: largest relative change of the gains", 2.0, gt=0, le=100)

    @model_validator(mode="after")
    def _softest_first(self) -> "ForceLoop":
        if refusal := order_refused(self.schedule):
            raise ValueError(f"schedule: {refusal}")
        return self


class Touch(Section):
    """[controller.touch]: how the controller feels contact in a task."""

    contact: float = quantity("contact_N", "pressing force that counts as touching", gt=0)
    patience: float = quantity("patience_ms", "how long contact may be lost while pressing", gt=0)
    turn: float = quantity("turn_ms", "how long before its lowest point the first tap turns round", ge=0, le=100)
    learning: float = Field(ge=0, le=1, description="share of a tap's depth error that the next one corrects")
    force_learning: float = Field(
        0.0,
        ge=0,
        le=1,
        description="share of a tap's force error that the next one corrects; needs [controller.tissue]",
    )


class FeedForward(Section):
    """[controller.feed_forward]: what the controller believes of the drives' lag and the friction under the head."""

    lag: float = quantity("lag_ms", "believed lag of the drives", ge=0)
    friction: float = Field(ge=0, description="believed friction under the head")


class Damping(Section):
    """[controller.damping]: how the motors give way to swings of the springs' torque."""

    gain: float = quantity("gain_rad_per_s_per_Nm", "motor speed per torque of the spring", ge=0)
    corner: float = quantity("corner_Hz", "swings slower than this are not damped", gt=0)


class EnergyTank(Section):
    """[controller.energy_tank]: a store of energy, out of which comes what the robot gives to what it touches."""

    size: float = quantity("size_J", "energy that may go into what is touched", gt=0, examples=[0.15])
    horizon: float = quantity(
        "horizon_ms", "how long it has to last whatever happens: longer than delays and the drives' lag", 100.0, gt=0
    )
    touch: float = quantity("touch_N", "estimated force from which on something is touched", 0.3, gt=0)
    release: float | None = quantity(
        "release_s", "after so long without touch it is full again; without it never", None, gt=0, examples=[0.5]
    )
    bias: float = quantity(
        "bias_Nm", "how far the estimated torque of a joint may be off: charged along its way while touched", 4e-3, ge=0
    )


class Controller(Section):
    """[controller]: the robot's computer. `touch`, `feed_forward` and `damping` belong to tasks."""

    mode: Literal["force_position", "position"] = Field(description="force and position, or position alone")
    period: float = quantity("period_ms", "time between two commands", gt=0)
    delay_ticks: int = Field(0, ge=0, le=1000, description="computation delay")
    bus_delay_ticks: int = Field(0, ge=0, le=1000, description="delay of the bus to the drives, behind the monitor")
    speed_limit: float = quantity("speed_limit_rad_per_s", "largest motor speed it commands", gt=0)
    gravity_compensation: bool = Field(description="take the robot's own weight out of the estimated force")
    dead_zone: float = quantity(
        "dead_zone_deg",
        "believed half width of the backlash, which the estimator takes off; 0: the paper's estimator",
        0.0,
        ge=0,
    )
    position: PositionLoop
    force: ForceLoop
    touch: Touch | None = None
    feed_forward: FeedForward | None = None
    damping: Damping | None = None
    tissue: Tissue | None = None
    breath: Breath | None = None
    energy_tank: EnergyTank | None = None
    model: Model
