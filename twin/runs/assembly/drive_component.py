"""A planned drive as one component with the contract's ports, whatever stands behind them."""

import math
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import replace

from twin.controller.pid import DriveSpeedLoop, Gains
from twin.controller.position_command import DriveSpeedIntegrator, Servo
from twin.cosim.component import Component
from twin.cosim.port import Port
from twin.cosim.subsystem import INLET, Subsystem
from twin.drive.component import FmuComponent
from twin.drive.contract import COMMANDS, LOAD, SHAFT, DriveRotor, Unwrapped
from twin.drive.description import FmuDescription, refuse_step
from twin.drive.setting import Setup
from twin.drive.stepping import FmuPort
from twin.drive.variable import Conversion
from twin.experiment.schema import PositionCommand
from twin.runs.assembly.drives import ENABLE, DrivePlan, Start, belongs
from twin.runs.assembly.rates import rates, stop_time
from twin.units import NUMBER

OMEGA_REF = COMMANDS["velocity"].port


def drive(name: str, plan: DrivePlan, tick: float, theta_m: Start, tau_load: Start) -> Component:
    """The component: outputs as `plan.outputs`, inputs omega_ref and tau_load.

    Args:
        tick: of the system it will be part of (s).
        theta_m: motor angle at t = 0 (rad).
        tau_load: load at t = 0 (N m). Three of each for a drive of three axes.

    Raises:
        InputRefused: an FMU cannot be loaded or initialised, or the rates do not fit the tick.
    """
    substeps, period = rates(name, plan.table, tick)
    alone = plan.is_bare and len(plan.parts) == 1 and substeps == 1
    with ExitStack() as made:
        parts = []
        for part, description in plan.parts.items():
            refuse_step(description, tick, substeps)
            stop = stop_time(plan.ticks, tick, substeps)
            setup = Setup(plan.tolerance(part), stop, tick / substeps, plan.ramped and alone)
            parts.append(_part(part or name, part, plan, description, theta_m, tau_load, setup))
            made.callback(parts[-1].close)
        if alone:
            component: Component = parts[0]
        else:
            component = _inner_system(name, plan, parts, tick, substeps, period, theta_m)
        made.pop_all()
    return component


def _part(
    name: str,
    part: str,
    plan: DrivePlan,
    description: FmuDescription,
    theta_m: Start,
    tau_load: Start,
    setup: Setup,
) -> FmuComponent:
    """One FMU: ports for the roles it fills, and for its ends of wires between parts."""
    mine = [b for b in plan.bindings if belongs(part, b.name)]
    # an optional input keeps the value it was given before initialisation
    inputs = [
        FmuPort(b.port, b.variable, b.gain, b.offset)
        for b in mine
        if b.role.causality == "input"
        and (b.role.required or b.role in SHAFT or (plan.switched and b.port.name == ENABLE))
    ]
    outputs = [FmuPort(b.port, b.variable, b.gain, b.offset) for b in mine if b.role.causality == "output"]
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
        inputs_at_start={"tau_load": tau_load, ENABLE: 1.0, "theta_m": theta_m},
        outputs_at_start={"theta_m": theta_m},
        setup=setup,
        solver=plan.solver(part),
    )


def _wire_port(part: str, description: FmuDescription, end: str) -> FmuPort:
    variable = description.variables[end.removeprefix(f"{part}.")]
    _, gain, offset = variable.conversion or Conversion(NUMBER)
    return FmuPort(Port(_port_name(end), variable.size, "SI", variable.description), variable, gain, offset)


def _port_name(end: str) -> str:
    """A port name for a wire's end that no role has, without the dots that wires are written with."""
    return "wire:" + end.replace(".", ":")


def _inner_system(
    name: str, plan: DrivePlan, parts: list[FmuComponent], tick: float, substeps: int, period: int, theta_m: Start
) -> Component:
    """The drive as a system of its own with a finer tick."""
    takes = {port.name: f"{part.name}.{port.name}" for part in parts for port in part.inputs}
    gives = {port.name: f"{part.name}.{port.name}" for part in parts for port in part.outputs}
    table, command = plan.table, COMMANDS[plan.table.command].port
    components: list[Component] = list(parts)
    wires = [(gives[_port_name(source)], takes[_port_name(target)]) for source, target in plan.wires]
    servo = _servo(plan, parts)
    if math.isfinite(servo.wrap):
        components.append(Unwrapped(math.tau / abs(servo.ratio), float(theta_m)))
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
    inputs = [replace(port, size=plan.axes) for port in (OMEGA_REF, LOAD.port)]
    if plan.switched:
        inputs.append(plan.port(ENABLE))
    wires += [(f"{INLET}.{port.name}", takes[port.name]) for port in inputs]
    return Subsystem(
        name, tuple(inputs), outputs, components, wires, tick / substeps, substeps, label=plan.label
    )  # fmt: skip


def _servo(plan: DrivePlan, parts: Sequence[FmuComponent]) -> Servo:
    """How the FMU counts its shaft's angle, where it is told a position."""
    said = plan.table.position_command or PositionCommand()
    if plan.table.command != "position":
        return Servo(0.0, 1.0)
    (bound,) = (b for b in plan.bindings if b.port.name == "command")
    _, factor, _ = bound.variable.conversion or Conversion(NUMBER)
    zeros = [part.zero("theta_m") for part in parts if any(port.name == "theta_m" for port in part.outputs)]
    return Servo(
        zero=zeros[0] if zeros else 0.0,
        ratio=factor / bound.gain,
        lower=-math.inf if said.lower is None else said.lower,
        upper=math.inf if said.upper is None else said.upper,
        wrap=math.inf if said.wrap_from is None else said.wrap_from,
        lead=math.inf if said.lead is None else said.lead,
    )
