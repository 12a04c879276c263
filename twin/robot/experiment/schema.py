"""The tables of an experiment file that no part declares. Keys carry units, attributes are SI.

See `twin.kernel.settings`.

Times of an experiment as whole ticks.
"""

import math
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from twin.kernel.settings import Settings, setting


class Cosim(Settings):
    """[cosim]: how the components are stepped."""

    tick: float = setting("ms", gt=0, help="step in which the components exchange their values")
    scheme: Literal["gauss_seidel", "jacobi"] = setting(
        help="whether plant and drives see each other's newest values, or all those of the tick before"
    )
    inputs: Literal["hold", "linear"] = setting(
        default="hold", help="whether they see values of one end of the step, or a line between both ends"
    )
    iterations: int = setting(default=1, ge=1, le=100, help="how often plant and drives make each step")


class Recorded(Settings):
    """[recording]: how often the plant, the drives and whatever else has values every tick are recorded."""

    rate: Literal["tick", "controller"] = setting(
        default="tick", help="every tick, or once per period of the controller: half the file"
    )


class VelocityLoop(Settings):
    """[drive.velocity_loop]: our discrete PI before a drive that takes no speed. Gains in the command's SI unit."""

    kp: float = setting(ge=0, examples=[0.08], help="gain, command per rad/s")
    ki: float = setting(default=0.0, ge=0, help="integral gain, command per rad")
    limit: float = setting(gt=0, examples=[0.6], help="largest command")
    period: float = setting("ms", gt=0, examples=[0.25], help="time between two commands")


class PositionCommand(Settings):
    """[drive.position_command]: how a servo that takes a position is told it; angles as the servo counts its own."""

    period: float | None = setting(
        "ms", into=None, default=None, gt=0, examples=[1.0], help="time between two commands; else one per tick"
    )
    lower: float | None = setting(
        "deg", default=None, absent=-math.inf, examples=[-150.0], help="smallest angle that it takes"
    )
    upper: float | None = setting(
        "deg", default=None, absent=math.inf, examples=[150.0], help="largest angle that it takes"
    )
    wrap_from: float | None = setting(
        "deg",
        field="wrap",
        default=None,
        absent=math.inf,
        examples=[-180.0],
        help="it counts its angle from here over one turn only",
    )
    lead: float | None = setting(
        "deg",
        default=None,
        absent=math.inf,
        gt=0,
        examples=[20.0],
        help="most by which the command is ahead of the robot's motor shaft",
    )

    @model_validator(mode="after")
    def _in_order(self) -> "PositionCommand":
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise ValueError("lower_deg: expected less than upper_deg")
        return self


class Rotor(Settings):
    """[drive.rotor]: a shaft of ours behind an FMU that gives a torque, felt at the robot's motor shaft."""

    J: float = setting("kg m2", gt=0, examples=[1e-4], help="inertia")
    b: float = setting("N m s/rad", default=0.0, ge=0, help="viscous friction")


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


class Part(Settings):
    """[drive.parts.NAME]: one FMU of a drive that is made of several."""

    fmu: str = setting(help="an .fmu file")
    sha256: str | None = setting(default=None, examples=["00000000..."], help="refuse any other file")
    parameters: dict[str, Parameter] = Field(default_factory=dict, description=PARAMETERS)
    tolerance: float | None = setting(default=None, gt=0, examples=[1e-9], help=TOLERANCE)
    kind: Kind | None = setting(default=None, examples=["model_exchange"], help=KIND)
    solver: Method | None = setting(default=None, examples=["rk4"], help=METHOD)
    solver_step: float | None = setting("ms", default=None, gt=0, examples=[0.1], help=SOLVER_STEP)


class Drive(Settings):
    """[drive], [drive.joint_1] ..: a drive. Names and units of variables and parameters are the FMU's own.

    Either `fmu`, or `parts` with `wires` between them; variables of parts are called "part.variable".
    """

    fmu: str | None = setting(default=None, examples=["fmus/pmsm_foc"], help="an .fmu file, or a folder of fmus/")
    sha256: str | None = setting(default=None, examples=["00000000..."], help="refuse any other file")
    command: Literal["velocity", "torque", "current", "voltage", "position"] = setting(
        default="velocity", help="what the drive takes; torque, current and voltage need a [drive.velocity_loop]"
    )
    sign: Literal[1, -1] = setting(default=1, help="-1: the FMU counts the other way round")
    gear_ratio: float = setting(default=1.0, gt=0, help="turns of the FMU's shaft per turn of the motor shaft")
    substeps: int = setting(default=1, ge=1, le=10_000, help="steps of the FMU per tick")
    inputs: dict[str, str] = Field(default_factory=dict, description="our name = the FMU's")
    outputs: dict[str, str] = Field(default_factory=dict, description="our name = the FMU's")
    parameters: dict[str, Parameter] = Field(default_factory=dict, description=PARAMETERS)
    tolerance: float | None = setting(default=None, gt=0, examples=[1e-9], help=TOLERANCE)
    kind: Kind | None = setting(default=None, examples=["model_exchange"], help=KIND)
    solver: Method | None = setting(default=None, examples=["rk4"], help=METHOD)
    solver_step: float | None = setting("ms", default=None, gt=0, examples=[0.1], help=SOLVER_STEP)
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


MOST_TICKS = 1e12
"""Three centuries at 10 ms, or what nobody means."""


def whole_ticks(time: float, tick: float) -> int | None:
    """How many ticks (s) `time` (s) is; None if it is no whole number of them, up to rounding of the two, or more than
    `MOST_TICKS`."""
    if time / tick > MOST_TICKS:
        return None
    count = round(time / tick)
    return count if abs(count * tick - time) <= 1e-9 * time else None
