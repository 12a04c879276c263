"""Drives of the joints: from a [drive] table to a checked plan, and to a component.

The component has the contract's ports, whatever implements it; the plan also contains its step rates.
"""

import math
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.subsystem import INLET_NAME, Subsystem
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.fmi.description import FmuDescription, described, refuse_step
from twin.kernel.fmi.solvers import DEFAULT_TOLERANCE, Solver
from twin.kernel.fmi.stepping import FmuPort
from twin.kernel.fmi.unpacked import unpacked
from twin.kernel.fmi.variable import Conversion, Setting, Setup, Variable, stop_time
from twin.kernel.settings import numbers
from twin.kernel.units import NUMBER
from twin.robot.controller.drive_loops import DriveSpeedIntegrator, DriveSpeedLoop, Servo
from twin.robot.controller.pid import Gains
from twin.robot.drive.contract import (
    COMMAND_ROLES,
    LOAD_ROLE,
    OMEGA_M_ROLE,
    SHAFT_INPUT_ROLES,
    THETA_M_ROLE,
    AngleUnwrapper,
    DriveRotor,
)
from twin.robot.drive.mapping import Binding, Wiring, bindings, split_unit
from twin.robot.experiment.schema import Drive, PositionCommand

if TYPE_CHECKING:
    from twin.kernel.systems.enclosed import EnclosedComponent, EnclosedSystem

Start = float | np.ndarray
ENABLE_ROLE = "enable"
"""The optional role that switches a drive's power."""
ONLY_PART = ""
"""Part name in a drive of a single FMU."""
OMEGA_REF = COMMAND_ROLES["velocity"].port


@dataclass(frozen=True)
class DrivePlan:
    """The checked plan of a drive, made without loading its binaries.

    Attributes:
        label: name in error messages.
        settings: values to set, by part.
        wires: (output, input) between parts, "part.variable" each.
        switched: whether its role `enable` is an input of the component; else it keeps its initial value.
        ticks: number of steps to come; None if unknown.
        ramped: whether its inputs are linear over a step.
        folders: verified unpacked folders by SHA-256, shared by one robot; None to verify for every component.
        system: enclosing SSP of the parts, if the drive is one.
    """

    label: str
    table: Drive
    parts: dict[str, FmuDescription]
    settings: Mapping[str, Sequence[Setting]]
    bindings: tuple[Binding, ...]
    wires: tuple[tuple[str, str], ...]
    switched: bool = False
    ticks: int | None = None
    ramped: bool = False
    folders: dict[str, Path] | None = field(default=None, compare=False, repr=False)
    system: "EnclosedSystem | None" = None

    def folder(self, part: str) -> Path:
        """Return the folder into which the FMU of a drive part is unpacked."""
        if self.system is not None:
            return self.system.folder(part)
        fmu = self.parts[part]
        known = {} if self.folders is None else self.folders
        if fmu.sha256 not in known:
            known[fmu.sha256] = unpacked(fmu.path, fmu.sha256)
        return known[fmu.sha256]

    def with_enable_input(self) -> "DrivePlan":
        """Return the plan with its enable signal as an input, unless it has no such signal or fixes it."""
        fixed = {qualified_name(part, v.name) for part, settings in self.settings.items() for v, _ in settings}
        return replace(self, switched=any(b.port.name == ENABLE_ROLE and b.name not in fixed for b in self.bindings))

    def tolerance(self, part: str) -> float | None:
        """Return a part's tolerance: the experiment's, FMU's or CVODE's default; None if its solver takes none."""
        own = self.table.parts[part].tolerance if part in self.table.parts else None
        stated = self.table.tolerance if own is None else own
        stated = self.parts[part].tolerance if stated is None else stated
        solver = self.solver(part)
        return DEFAULT_TOLERANCE if stated is None and solver is not None and solver.method == "cvode" else stated

    def solver(self, part: str) -> Solver | None:
        """Return twin's solver for a model-exchange FMU of the drive; None for a co-simulation FMU."""
        if self.parts[part].kind == "co_simulation":
            return None
        own = self.table.parts.get(part, self.table)
        step = self.table.solver_step if own.solver_step is None else own.solver_step
        return Solver(own.solver or self.table.solver or "cvode", step)

    @property
    def is_bare(self) -> bool:
        """Whether the drive's FMU is wired directly, without twin's velocity loop, rotor or position command."""
        return self.table.velocity_loop is self.table.rotor is None and self.table.command != "position"

    @property
    def axes(self) -> int:
        """Number of joints moved by one instance of the drive: 1 or 3."""
        return self.port(COMMAND_ROLES[self.table.command].port.name).size

    def port(self, name: str) -> Port:
        """Return the contract port that the drive fills for the role `name`."""
        return next(b.port for b in self.bindings if b.port.name == name)

    @property
    def outputs(self) -> tuple[Port, ...]:
        """Outputs of the drive contract that the drive offers; outputs of twin's rotor come first."""
        own = (THETA_M_ROLE.port, OMEGA_M_ROLE.port) if self.table.rotor else ()
        return (*own, *(b.port for b in self.bindings if b.role.causality == "output"))

    def warnings(self) -> list[str]:
        """Return warnings about an accepted drive: algebraic loops, undeclared units, unwired shaft speed."""
        loops = [
            f"{name} depends directly on {load.name} (ModelStructure). With the spring that makes an algebraic loop, "
            "tau_load = k_s (theta_m - N theta_l); the master breaks it by one step of delay, which costs accuracy "
            "and, above a gain of 1, stability. Export the drive with theta_m as a state, or raise [drive] substeps"
            for load in self.bindings
            if load.port.name == "tau_load"
            for name in self._direct_feedthrough(load.name)
        ]
        unstated = [b.port for b in self.bindings if not b.variable.unit]
        if self.table.rotor and not any(b.role in SHAFT_INPUT_ROLES for b in self.bindings):
            loops.append("nothing feeds its shaft speed; if it has an input for that: [drive.inputs] omega_m")
        return loops + [f"{port.name}: the FMU states no unit; taken as {port.unit}" for port in unstated]

    def _direct_feedthrough(self, load: str) -> list[str]:
        """Return the drive's motion outputs that depend on the load without delay, as its FMU declares."""
        motion = {b.name: b.port.name for b in self.bindings if b.port.name in ("theta_m", "omega_m")}
        return [
            motion[name]
            for part, description in self.parts.items()
            for unknown in description.model.outputs
            if (name := qualified_name(part, unknown.variable.name)) in motion
            and any(qualified_name(part, known.name) == load for known in unknown.dependencies or ())
        ]


def plan_drive(table: Drive) -> DrivePlan:
    """Check a drive without loading its binaries and return its plan.

    Raises:
        InputRefused: an FMU, its hash, the mapping, a parameter or a wire is invalid.
    """
    if table.fmu is not None and is_system(Path(table.fmu)):
        return _check_axes(_plan_system(table))
    parts = _descriptions(table)
    given = {name: part.parameters for name, part in table.parts.items()} or {ONLY_PART: table.parameters}
    parts = {name: description.with_sizes(given[name]) for name, description in parts.items()}
    variables = {
        qualified_name(part, v.name): v for part, description in parts.items() for v in description.variables.values()
    }
    label = " + ".join(dict.fromkeys(d.path.name for d in parts.values()))
    free = {name: v for name, v in variables.items() if name not in table.wires}
    plan = DrivePlan(
        label=label,
        table=table,
        parts=parts,
        settings={name: parts[name].settings(values) for name, values in given.items()},
        bindings=bindings(label, free, _wiring(table)),
        wires=tuple(_checked_wire(label, variables, source, target) for target, source in table.wires.items()),
    )
    _refuse_idle_solvers(plan)
    return _check_axes(plan)


def _plan_system(table: Drive) -> DrivePlan:
    system = _enclosed_system(table)
    label, wiring = system.path.name, _wiring(table)
    for key in ("tolerance", "kind", "solver", "solver_step"):
        if getattr(table, key) is not None:
            raise InputRefused(f"{system.path}: [drive] {key}: each FMU of an SSP has its own; remove it")
    free = {name: v for name, v in system.variables.items() if name not in table.parameters}
    return DrivePlan(label, table, system.descriptions, system.values, bindings(label, free, wiring), system.links,
                     system=system)  # fmt: skip


def _enclosed_system(table: Drive) -> "EnclosedSystem":
    from twin.kernel.systems.enclosed import enclose_system

    mapped = [*table.inputs.values(), *table.outputs.values()]
    # a variable inside, or a variable with its unit
    names = [*mapped, *(split_unit(name)[0] for name in mapped)]
    system = enclose_system(Path(table.fmu or ""), "drive", table.parameters, names)
    refuse_other_file(system.path, system.sha256, table.sha256)
    return system


def _wiring(table: Drive) -> Wiring:
    return Wiring(table.command, table.sign, table.gear_ratio, table.inputs, table.outputs, table.rotor is not None)


def _check_axes(plan: DrivePlan) -> DrivePlan:
    """Refuse a drive of several axes behind twin's one-axis rotor or velocity loop; else return its plan unchanged."""
    table, label = plan.table, plan.label
    if plan.axes > 1 and not plan.is_bare:
        ours = "rotor turns" if table.rotor else "loop drives"
        raise InputRefused(f"{label}: three axes in one FMU with a {table.command} command; our {ours} one axis")
    return plan


def fmus(table: Drive) -> "Mapping[str, FmuDescription | EnclosedSystem]":
    """Return the descriptions of a drive's FMUs by part name; an SSP is one entry under `ONLY_PART`."""
    if table.fmu is not None and is_system(Path(table.fmu)):
        system = _enclosed_system(table)
        return {ONLY_PART: system, **system.descriptions}
    return _descriptions(table)


def _descriptions(table: Drive) -> dict[str, FmuDescription]:
    files = {name: (part.fmu, part.sha256, part.kind or table.kind) for name, part in table.parts.items()}
    files = files or {ONLY_PART: (table.fmu or "", table.sha256, table.kind)}
    found = {}
    for name, (fmu, digest, kind) in files.items():
        found[name] = described(Path(fmu), kind)
        refuse_other_file(found[name].path, found[name].sha256, digest)
    return found


def _refuse_idle_solvers(plan: DrivePlan) -> None:
    """Refuse a solver that the experiment sets for an FMU with its own solver."""
    named = {name: part.solver for name, part in plan.table.parts.items()}
    if plan.table.solver and all(fmu.kind == "co_simulation" for fmu in plan.parts.values()):
        named[next(iter(plan.parts))] = plan.table.solver
    for part, method in named.items():
        fmu = plan.parts[part]
        if method and fmu.kind == "co_simulation":
            remedy = 'set kind = "model_exchange"' if len(fmu.kinds) > 1 else "remove it"
            raise InputRefused(f'{fmu.path}: solver = "{method}", and it brings its own for co-simulation; {remedy}')


def is_system(file: Path) -> bool:
    """Whether a file is an SSP, by its extension."""
    return file.suffix.lower() == ".ssp"


def refuse_other_file(file: Path, sha256: str, pinned: str | None) -> None:
    """Refuse a file whose SHA-256 differs from the pinned one; without a pinned hash, accept any file."""
    if pinned is not None and pinned.lower() != sha256:
        raise InputRefused(
            f"{file}: has sha256 {sha256}; the experiment pins {pinned.lower()}. It is another file: get the "
            "pinned one, or change sha256"
        )


def qualified_name(part: str, variable: str) -> str:
    """Return the name of a variable as the user writes it: with its part in a drive of several parts (`machine.R`)."""
    return f"{part}.{variable}" if part else variable


def belongs(part: str, name: str) -> bool:
    """Whether a variable name, as the user writes it, refers to the given part of the drive."""
    return part == ONLY_PART or name.startswith(f"{part}.")


def _checked_wire(label: str, variables: dict[str, Variable], source: str, target: str) -> tuple[str, str]:
    for end, wanted in ((source, ("output", "local")), (target, ("input",))):
        if end not in variables:
            raise InputRefused(f"{label}: [drive.wires] '{end}': no such variable; write part.variable")
        if variables[end].causality not in wanted:
            raise InputRefused(
                f"{label}: [drive.wires] '{end}' has causality {variables[end].causality}; expected {wanted[0]}"
            )
    a, b = variables[source].conversion, variables[target].conversion
    if a and b and a.dimension != b.dimension:
        raise InputRefused(
            f'{label}: [drive.wires] "{target}" = "{source}": units \'{variables[target].unit}\' and '
            f"'{variables[source].unit}' have different dimensions"
        )
    return source, target


def rates(name: str, table: Drive, tick: float) -> tuple[int, int]:
    """Return a drive's (inner ticks per tick, inner ticks per command of twin's velocity loop, by default one tick)."""
    key, loop = next(
        ((key, found) for key in ("velocity_loop", "position_command") if (found := getattr(table, key))), ("", None)
    )
    if loop is None or loop.period is None:
        return table.substeps, table.substeps
    substeps = max(table.substeps, round(tick / loop.period))
    period = round(loop.period / (tick / substeps))
    if period < 1 or abs(period * tick / substeps - loop.period) > 1e-9 * loop.period:
        raise InputRefused(
            f"{name}: [drive.{key}] period_ms = {1e3 * loop.period:g} does not divide into the "
            f"{substeps} steps per tick of {1e3 * tick:g} ms; choose a period or substeps that fit"
        )
    return substeps, period


def drive(name: str, plan: DrivePlan, tick: float, theta_m: Start, tau_load: Start) -> Component:
    """Create the component of a drive in this process, with the inputs omega_ref and tau_load.

    Args:
        tick: tick of the surrounding system (s).
        theta_m: motor angle at t = 0 (rad).
        tau_load: load at t = 0 (N m). Three of each for a drive of three axes.
    """
    substeps, period = rates(name, plan.table, tick)
    alone = plan.is_bare and (len(plan.parts) == 1 or plan.system is not None) and substeps == 1
    with ExitStack() as made:
        parts: list[FmuComponent | EnclosedComponent] = []
        if plan.system is not None:
            inputs, outputs = _ports(plan, plan.bindings)
            parts.append(
                plan.system.component(
                    name if alone else "system", inputs, outputs, tick / substeps, 1, (plan.ticks or 0) * substeps,
                    inputs_at_start={"tau_load": tau_load, ENABLE_ROLE: 1.0, "theta_m": theta_m},
                    outputs_at_start={"theta_m": theta_m},
                )
            )  # fmt: skip
            made.callback(parts[-1].close)
        for part, description in plan.parts.items() if plan.system is None else ():
            refuse_step(description, tick, substeps)
            stop = stop_time(plan.ticks, tick, substeps)
            setup = Setup(plan.tolerance(part), stop, tick / substeps, plan.ramped and alone)
            parts.append(_fmu_component(part or name, part, plan, description, theta_m, tau_load, setup))
            made.callback(parts[-1].close)
        if alone:
            component: Component = parts[0]
        else:
            component = _inner_system(name, plan, parts, tick, substeps, period, theta_m)
        made.pop_all()
    return component


def _ports(plan: DrivePlan, mine: Sequence[Binding]) -> tuple[list[FmuPort], list[FmuPort]]:
    """Return the FMU inputs and outputs for the roles that one part of a drive fills."""
    # an unwired optional input keeps its initial value
    inputs = [
        FmuPort(b.port, b.variable, b.gain, b.offset)
        for b in mine
        if b.role.causality == "input"
        and (b.role.required or b.role in SHAFT_INPUT_ROLES or (plan.switched and b.port.name == ENABLE_ROLE))
    ]
    return inputs, [FmuPort(b.port, b.variable, b.gain, b.offset) for b in mine if b.role.causality == "output"]


def _fmu_component(
    name: str,
    part: str,
    plan: DrivePlan,
    description: FmuDescription,
    theta_m: Start,
    tau_load: Start,
    setup: Setup,
) -> FmuComponent:
    """Create the component of one FMU of a drive, with ports for its roles and for its wires to other parts."""
    inputs, outputs = _ports(plan, [b for b in plan.bindings if belongs(part, b.name)])
    inputs += [_wire_port(part, description, target) for _, target in plan.wires if belongs(part, target)]
    sources = dict.fromkeys(source for source, _ in plan.wires if belongs(part, source))
    outputs += [_wire_port(part, description, source) for source in sources]
    return FmuComponent(
        name,
        description,
        plan.folder(part),
        inputs,
        outputs,
        plan.settings[part],
        inputs_at_start={"tau_load": tau_load, ENABLE_ROLE: 1.0, "theta_m": theta_m},
        outputs_at_start={"theta_m": theta_m},
        setup=setup,
        solver=plan.solver(part),
    )


def _wire_port(part: str, description: FmuDescription, end: str) -> FmuPort:
    variable = description.variables[end.removeprefix(f"{part}.")]
    _, gain, offset = variable.conversion or Conversion(NUMBER)
    return FmuPort(Port(_port_name(end), variable.size, "SI", variable.description), variable, gain, offset)


def _port_name(end: str) -> str:
    """Return a port name for a wire's end that fills no role; dots, which separate names in wires, are replaced."""
    return "wire:" + end.replace(".", ":")


def _inner_system(
    name: str,
    plan: DrivePlan,
    parts: "list[FmuComponent | EnclosedComponent]",
    tick: float,
    substeps: int,
    period: int,
    theta_m: Start,
) -> Component:
    """Build a drive of several parts as one component: a subsystem with a finer tick."""
    takes = {port.name: f"{part.name}.{port.name}" for part in parts for port in part.inputs}
    gives = {port.name: f"{part.name}.{port.name}" for part in parts for port in part.outputs}
    table, command = plan.table, COMMAND_ROLES[plan.table.command].port
    components: list[Component] = list(parts)
    between = plan.wires if plan.system is None else ()
    wires = [(gives[_port_name(source)], takes[_port_name(target)]) for source, target in between]
    servo = _servo(plan, parts)
    if math.isfinite(servo.wrap):
        components.append(AngleUnwrapper(math.tau / abs(servo.ratio), float(theta_m)))
        wires.append((gives["theta_m"], "unwrapped.wrapped"))
        gives["theta_m"] = "unwrapped.theta_m"
    if table.rotor:
        rotor = DriveRotor(table.rotor.J, table.rotor.b, float(theta_m))
        components.append(rotor)
        wires.append((gives["tau_motor"], "rotor.tau_motor"))
        takes["tau_load"] = "rotor.tau_load"
        for port in rotor.outputs:
            gives[port.name] = f"rotor.{port.name}"
            if port.name in takes:
                wires.append((gives[port.name], takes[port.name]))
    outputs = [(port, gives[port.name]) for port in plan.outputs]
    if table.command == "position":
        components.append(DriveSpeedIntegrator(servo, float(theta_m), period))
        wires += [(gives["theta_m"], "position_command.theta_m"), ("position_command.goal", takes["command"])]
        takes["omega_ref"] = "position_command.omega_ref"
        outputs.append((command, "position_command.command"))
    elif table.velocity_loop:
        loop = table.velocity_loop
        components.append(DriveSpeedLoop(Gains(loop.kp, loop.ki), loop.limit, command, period))
        wires += [(gives["omega_m"], "velocity_loop.omega_m"), ("velocity_loop.command", takes["command"])]
        takes["omega_ref"] = "velocity_loop.omega_ref"
        outputs.append((command, "velocity_loop.command"))
    inputs = [replace(port, size=plan.axes) for port in (OMEGA_REF, LOAD_ROLE.port)]
    if plan.switched:
        inputs.append(plan.port(ENABLE_ROLE))
    wires += [(f"{INLET_NAME}.{port.name}", takes[port.name]) for port in inputs]
    return Subsystem(
        name, tuple(inputs), outputs, components, wires, tick / substeps, substeps, label=plan.label
    )  # fmt: skip


def _servo(plan: DrivePlan, parts: "Sequence[FmuComponent | EnclosedComponent]") -> Servo:
    """Return the angle convention and limits of a drive that is commanded by position."""
    stated = plan.table.position_command or PositionCommand()
    if plan.table.command != "position":
        return Servo(0.0, 1.0)
    (bound,) = (b for b in plan.bindings if b.port.name == "command")
    _, factor, _ = bound.variable.conversion or Conversion(NUMBER)
    zeros = [part.zero("theta_m") for part in parts if any(port.name == "theta_m" for port in part.outputs)]
    return Servo(zero=zeros[0] if zeros else 0.0, ratio=factor / bound.gain, **numbers(stated))
