"""Tables of an experiment file that no part declares. Keys carry units, attributes are SI.

See `twin.kernel.settings`. A [[change]] sets a controller parameter at a time, such as a step of the force reference.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated, Any, Literal, NamedTuple, TypeVar

from pydantic import BeforeValidator, Field, create_model, field_validator, model_validator
from pydantic_core import PydanticCustomError

from twin.kernel.errors import InputRefused
from twin.kernel.settings import FieldSource, Settings, Triple, optional, setting
from twin.robot.experiment.mistakes import (
    check_kind,
    check_table,
    nested_model,
    numbered_tables,
    toml_keys,
    unknown_key,
)
from twin.robot.experiment.source import REFERENCE_SHAPES, RETAINED_KEYS, value_at

MAX_TICKS = 1e12
"""Maximum number of ticks, three centuries at 10 ms: more is a typing error."""
FORCE_LOOP_PREFIX = "controller.force."
"""Prefix of the force loop's keys."""
SCHEDULED_KEYS = ("controller.force.kp_mm_per_N", "controller.force.ki_mm_per_N_s")
"""Keys that may not change if [controller.force] has a schedule of them."""
Task = TypeVar("Task", bound=Settings)
Kind = Literal["co_simulation", "model_exchange"]
Method = Literal["cvode", "rk4"]


def nested_tables(model: type[Settings], path: str) -> dict[str, type[Settings]]:
    """Return a table's model and the models of all tables nested in it, by dotted path."""
    found = {path: model}
    for name, info in model.model_fields.items():
        inner = nested_model(info.annotation)
        if inner is not None and issubclass(inner, Settings):
            found |= nested_tables(inner, f"{path}.{info.alias or name}")
    return found


@dataclass(frozen=True, eq=False)
class DeclaredTables:
    """All tables that an experiment's file may have, and the keys that may change during a run.

    Attributes:
        needed, optional: tables by name, in the order of documents.
        changeable: settings that may change, by key in the file.
        tasks: tables of [[task]], by their key `kind`.
    """

    needed: Mapping[str, type[Settings]]
    optional: Mapping[str, type[Settings]]
    changeable: Mapping[str, FieldSource] = field(default_factory=dict)
    tasks: Mapping[str, type[Any]] = field(default_factory=dict)

    @property
    def tables(self) -> dict[str, type[Settings]]:
        return {**self.needed, **self.optional}

    def third_party_model(self, role: str) -> type[Settings]:
        """Return the table model of a third-party part, with mandatory keys only where twin needs them."""
        model = self.tables[role]
        idle: dict[str, Any] = {
            name: (Any, None)
            for name, info in model.model_fields.items()
            if info.is_required() and (info.alias or name) not in RETAINED_KEYS[role]
        }
        return create_model(model.__name__, __base__=model, **idle) if idle else model

    def model_keys(self) -> list[str]:
        """Keys of [controller.model], the controller's robot model; missing values are taken from the robot."""
        model = nested_model(self.tables["controller"].model_fields["model"].annotation)
        return [] if model is None else toml_keys(model)


class Circle(Settings):
    """[reference.circle]: horizontal circles, counter-clockwise from above, at constant speed from `start_s` on."""

    centre: Triple = setting("mm", examples=[[0.0, 0.0, -90.0]], help="centre of the circle (x, y, z) in frame B")
    radius: float = setting("mm", gt=0, examples=[15.0], help="radius of the circle, which begins at +x")
    rate: float = setting("Hz", gt=0, examples=[0.2], help="turns per second")
    turns: float = setting(gt=0, examples=[1.0], help="number of turns")
    start: float = setting("s", default=0.0, ge=0, help="time at rest before the motion")


class Chirp(Settings):
    """[reference.chirp]: a sine along one axis whose frequency grows linearly with time."""

    point: Triple = setting("mm", examples=[[0.0, 0.0, -90.0]], help="centre of the motion (x, y, z) in frame B")
    direction: Literal["x", "y", "z"] = setting(examples=["z"], help="axis of the motion in frame B")
    amplitude: float = setting("mm", gt=0, examples=[2.0], help="amplitude of the sine")
    begin: float = setting("Hz", gt=0, examples=[0.1], help="frequency at the beginning")
    end: float = setting("Hz", gt=0, examples=[2.0], help="frequency at the end")
    duration: float = setting("s", gt=0, examples=[10.0], help="duration of the sweep")
    start: float = setting("s", default=0.0, ge=0, help="time at rest before the motion")


class JointStep(Settings):
    """[reference.joint_step]: a step of the platform that changes the angle of a single joint."""

    point: Triple = setting("mm", examples=[[0.0, 0.0, -90.0]], help="initial platform position (x, y, z) in frame B")
    joint: Literal[1, 2, 3] = setting(examples=[1], help="joint that moves")
    step: float = setting("deg", examples=[2.0], help="change of the joint's angle; positive lowers the platform")
    start: float = setting("s", gt=0, examples=[0.5], help="time of the step")

    @field_validator("step")
    @classmethod
    def _moves(cls, step: float) -> float:
        if step == 0.0:
            raise ValueError("expected an angle other than 0")
        return step


class Reference(Settings):
    """[reference]: waypoints, straight lines at constant speed between them; or one shape."""

    t: tuple[float, ...] | None = optional(
        "s", min_length=1, example=[0.0, 2.0], help="times of the waypoints, increasing"
    )
    p: tuple[Triple, ...] | None = optional(
        "mm",
        min_length=1,
        example=[[0.0, 0.0, -90.0], [0.0, 0.0, -95.0]],
        help="positions (x, y, z) of the waypoints in frame B, one per time; the robot rests at the first",
    )
    circle: Circle | None = None
    chirp: Chirp | None = None
    joint_step: JointStep | None = None

    @field_validator("t")
    @classmethod
    def _ascending(cls, t: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if t is not None and any(later <= earlier for earlier, later in pairwise(t)):
            raise ValueError("expected times that increase from one way point to the next")
        return t

    @model_validator(mode="after")
    def _one_of_them(self) -> "Reference":
        points = self.t is not None or self.p is not None
        named = [name for name in REFERENCE_SHAPES if getattr(self, name) is not None]
        if points + len(named) != 1:
            got = ", ".join(["way points"] * points + named) or "nothing"
            raise ValueError(
                f"got {got}: expected either way points (t_s and p_mm) or one of {', '.join(REFERENCE_SHAPES)}"
            )
        if points and (self.t is None or self.p is None):
            raise ValueError(f"missing key '{'t_s' if self.t is None else 'p_mm'}': way points need t_s and p_mm")
        return self


class WayPoints(NamedTuple):
    """Waypoints of the reference: times (s, ascending), positions (m, frame B), and the shape's name or ""."""

    t: tuple[float, ...]
    p: tuple[Triple, ...]
    shape: str = ""


def checked_tasks(kinds: Mapping[str, type[Task]], tables: Any, mistakes: list[str]) -> dict[int, Task]:
    """Check the [[task]] tables of an experiment; return the valid massage tasks by number, from 1.

    `kinds` are the task models by key `kind`; `tables` is the array from the file, None if missing.
    """
    if tables is None:
        return {}
    if tables == ():
        mistakes.append("[[task]]: an empty array; expected at least one task, or [reference] with waypoints")
    found = {
        n: check_kind(kinds, table, f"task {n}", mistakes) for n, table in numbered_tables(tables, "task", mistakes)
    }
    return {number: task for number, task in found.items() if task is not None}


class Cosim(Settings):
    """[cosim]: stepping of the components."""

    tick: float = setting("ms", gt=0, help="communication step H of the co-simulation")
    scheme: Literal["gauss_seidel", "jacobi"] = setting(
        help="order of drives and plant: the plant gets the motor angles of the end of the step, or of its beginning"
    )
    inputs: Literal["hold", "linear"] = setting(
        default="hold", help="inputs of plant and drives over a step: the value of one end, or a line between both ends"
    )
    iterations: int = setting(
        default=1, ge=1, le=100, help="passes of plant and drives over each step; above 1, drives restore states"
    )


class RecordingSettings(Settings):
    """[recording]: recording rate of the plant, the drives and all other signals with a value every tick."""

    rate: Literal["tick", "controller"] = setting(
        default="tick", help="recording rate of signals with values every tick; controller: per period, half the file"
    )
    states: tuple[float, ...] = setting(
        "s", default=(), examples=[[5.0, 10.0]], help="times at which the state is saved, for twin run --from"
    )
    state_every: float | None = setting("s", default=None, gt=0, examples=[10.0], help="interval between saved states")

    @field_validator("states")
    @classmethod
    def _times(cls, states: tuple[float, ...]) -> tuple[float, ...]:
        if any(not 0.0 < t < math.inf for t in states):
            raise ValueError("expected times above 0")
        return states


class VelocityLoop(Settings):
    """[drive.velocity_loop]: twin's discrete PI for a drive without a speed command. Gains in the command's SI unit."""

    kp: float = setting(ge=0, examples=[0.08], help="proportional gain, command per rad/s")
    ki: float = setting(default=0.0, ge=0, help="integral gain, command per rad")
    limit: float = setting(gt=0, examples=[0.6], help="largest command")
    period: float = setting("ms", gt=0, examples=[0.25], help="period of the loop")


class PositionCommand(Settings):
    """[drive.position_command]: command of a servo by position; angles in the servo's own convention."""

    period: float | None = optional(
        "ms", into=None, gt=0, example=1.0, help="time between two commands; without it, one per tick"
    )
    lower: float | None = optional("deg", absent=-math.inf, example=-150.0, help="lower command limit, below upper_deg")
    upper: float | None = optional("deg", absent=math.inf, example=150.0, help="upper command limit")
    wrap_from: float | None = optional(
        "deg", field="wrap", absent=math.inf, example=-180.0, help="start of the single turn of the servo's angle"
    )
    lead: float | None = optional(
        "deg", absent=math.inf, gt=0, example=20.0, help="maximum lead of the command before the robot's motor shaft"
    )

    @model_validator(mode="after")
    def _in_order(self) -> "PositionCommand":
        if self.lower is not None and self.upper is not None and self.lower >= self.upper:
            raise ValueError("lower_deg: expected less than upper_deg")
        return self


class Rotor(Settings):
    """[drive.rotor]: a shaft simulated by twin, for an FMU that outputs a torque; values at the robot's motor shaft."""

    J: float = setting("kg m2", gt=0, examples=[1e-4], help="inertia of machine and gears")
    b: float = setting("N m s/rad", default=0.0, ge=0, help="viscous friction")


class UnpoweredDrive(Settings):
    """[drive.unpowered]: the motor shaft after a safety monitor has cut the power, with one line per drive.

    Without this table the FMU of an unpowered drive decides: it stops, or, with a role `enable`, it coasts.
    """

    holding: float = setting("N m", ge=0, examples=[0.02], help="maximum holding torque of gears and bearings")
    brake: float = setting("N m", default=0.0, ge=0, examples=[0.5], help="additional torque of a brake")
    brake_line: Literal["power", "own"] = setting(
        default="power", help="closing of the brake: with the power, or once no force is left that it would hold"
    )
    J: float = setting("kg m2", default=1e-4, gt=0, help="inertia of the shaft")
    b: float = setting("N m s/rad", default=1e-4, ge=0, help="viscous friction")


def _check_parameter(value: Any) -> Any:
    """Validate the value of an FMU parameter, with a single message for all possible types."""
    many = isinstance(value, (list, tuple))
    values = tuple(value) if many else (value,)
    kinds = {str if isinstance(v, str) else float if type(v) in (int, float) else None for v in values}
    if len(kinds) != 1 or None in kinds:
        raise PydanticCustomError("parameter_type", "no parameter")
    if kinds == {float} and not all(math.isfinite(v) for v in values):
        raise PydanticCustomError("finite_number", "no finite number")
    return values if many else value


Parameter = Annotated[float | str | tuple[float, ...] | tuple[str, ...], BeforeValidator(_check_parameter)]


class FmuTable(Settings):
    """Keys common to a drive and its parts."""

    fmu: str | None = optional(
        example="fmus/pmsm_foc", help=".fmu or .ssp file, folder with a mapping, or name in fmus/; instead of parts"
    )
    sha256: str | None = optional(example="00000000...", help="hash of the file; any other file is refused")
    parameters: dict[str, Parameter] = Field(
        default_factory=dict,
        description='own names and units of the FMU; enumerations by name, text, arrays, files as "file:NAME"',
    )
    tolerance: float | None = optional(
        gt=0,
        example=1e-9,
        help="relative tolerance of the solver, the FMU's or twin's for model exchange; without it, the FMU's default",
    )
    kind: Kind | None = optional(example="model_exchange", help="kind of FMU; without it, co-simulation if available")
    solver: Method | None = optional(
        example="rk4",
        help="solver for model exchange: cvode keeps the tolerance, rk4 has a fixed step; without it, cvode",
    )
    solver_step: float | None = optional(
        "ms", gt=0, example=0.1, help="longest step of rk4; without it, one per step of the drive"
    )


class DrivePart(FmuTable):
    """[drive.parts.NAME]: one FMU of a drive with several parts."""

    fmu: str = setting(help=".fmu file")


class Drive(FmuTable):
    """[drive], [drive.joint_1] ..: a drive. Names and units of variables and parameters are the FMU's own.

    Either `fmu`, or `parts` with `wires` between them; variables of parts are called "part.variable".
    """

    command: Literal["velocity", "torque", "current", "voltage", "position"] = setting(
        default="velocity", help="quantity of the command; torque, current and voltage need [drive.velocity_loop]"
    )
    sign: Literal[1, -1] = setting(default=1, help="-1 if the FMU counts in the opposite direction")
    gear_ratio: float = setting(default=1.0, gt=0, help="turns of the FMU's shaft per turn of the motor shaft")
    substeps: int = setting(default=1, ge=1, le=10_000, help="steps of the drive per tick")
    inputs: dict[str, str] = Field(default_factory=dict, description="role = name in the FMU")
    outputs: dict[str, str] = Field(default_factory=dict, description="role = name in the FMU")
    velocity_loop: VelocityLoop | None = None
    position_command: PositionCommand | None = None
    rotor: Rotor | None = None
    unpowered: UnpoweredDrive | None = None
    parts: dict[str, DrivePart] = Field(default_factory=dict, description="FMUs of a drive with several parts")
    wires: dict[str, str] = Field(default_factory=dict, description="wires between parts: part.input = part.output")

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
                raise ValueError('solver_step_ms belongs to solver = "rk4"; set that solver, or remove it')
        return self


def whole_ticks(time: float, tick: float) -> int | None:
    """Convert a time (s) to a whole number of ticks; None if it is not whole up to rounding, or above `MAX_TICKS`."""
    if time / tick > MAX_TICKS:
        return None
    count = round(time / tick)
    return count if abs(count * tick - time) <= 1e-9 * time else None


class ChangeTable(Settings):
    """[[change]]: a scheduled change of a value of [controller]."""

    t: float = setting("s", gt=0, examples=[8.0], help="time of the change; a whole number of ticks")
    key: str = setting(examples=["controller.force.reference_N"], help="key that changes, with its table and unit")
    value: float = setting(examples=[6.0], help="new value, in the unit of the key")


@dataclass(frozen=True)
class Change:
    """A checked [[change]]: the first tick with the new value, the key in the experiment's file, and the new value.

    `number` is in the unit of the key, `value` in SI.
    """

    tick: int
    key: str
    number: float
    value: float


def changeable_values(declared: DeclaredTables, tables: Mapping[str, Any]) -> dict[str, float]:
    """Return the current values of all keys that may change during a run, in the units of the keys.

    Keys of an idle force loop are left out, and the reference if tasks bring their own. `tables` is
    `Experiment.values`.
    """
    found = {}
    for key in declared.changeable:
        number = value_at(tables, key)
        acts = not key.startswith(FORCE_LOOP_PREFIX) or value_at(tables, "controller.mode") == "force_position"
        # a schedule sets these itself
        acts = acts and not (value_at(tables, "controller.force.schedule") and key in SCHEDULED_KEYS)
        if acts and number is not None:
            found[key] = number
    return found


def changed_value(declared: DeclaredTables, key: str, number: object, tables: Mapping[str, Any]) -> float:
    """Validate a new value for a changeable key of the experiment, in the key's unit, and convert it to SI.

    `number` is unvalidated; `tables` is `Experiment.values`.
    """
    if number is None:
        # a file may omit the reference if no force loop acts; a running loop needs it
        raise InputRefused(f"{key}: no value; expected a number")
    source = declared.changeable[key]
    path, _, name = key.rpartition(".")
    mistakes: list[str] = []
    changed = check_table(source.table, {**value_at(tables, path), name: number}, path, mistakes)
    if mistakes:
        raise InputRefused("; ".join(mistakes))
    return getattr(changed, source.name)


def checked_changes(
    declared: DeclaredTables, tables: Any, values: Mapping[str, Any], tick: float, duration: float, mistakes: list[str]
) -> tuple[Change, ...]:
    """Check the [[change]] tables of an experiment; return the valid changes, earliest first.

    `tables` is the array from the file, () if missing; `values` has all tables; `tick` and `duration` are in s.
    """
    changes: dict[tuple[int, str], Change] = {}
    for number, table in numbered_tables(tables, "change", mistakes):
        wanted = check_table(ChangeTable, table, f"change {number}", mistakes)
        if wanted is None:
            continue
        try:
            change = _check_change(declared, wanted, values, tick, duration)
        except InputRefused as problem:
            mistakes.append(f"[change {number}] {problem}")
            continue
        if (change.tick, change.key) in changes:
            mistakes.append(f"[change {number}] changes {change.key} at {wanted.t:g} s a second time; remove one")
        changes[change.tick, change.key] = change
    return tuple(changes[place] for place in sorted(changes))


def _check_change(
    declared: DeclaredTables, wanted: ChangeTable, values: Mapping[str, Any], tick: float, duration: float
) -> Change:
    known = changeable_values(declared, values)
    if wanted.key in declared.changeable and wanted.key not in known:
        raise InputRefused(f'key = "{wanted.key}": does not act in this experiment; known are {", ".join(known)}')
    if wanted.key not in known:
        raise InputRefused(f"key: {unknown_key(wanted.key, list(known))}")
    if wanted.t > duration:
        raise InputRefused(f"t_s = {wanted.t:g}: after the end at {duration:g} s")
    at = whole_ticks(wanted.t, tick)
    if at is None:
        raise InputRefused(f"t_s = {wanted.t:g}: not a whole number of ticks of {tick:g} s")
    return Change(at, wanted.key, wanted.value, changed_value(declared, wanted.key, wanted.value, values))
