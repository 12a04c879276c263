"""Export of an experiment's drives: their FMUs as delivered, and twin's own adapter components around them.

The master of a system of FMUs makes one step of every FMU per tick; a drive can be exported if that suffices.
"""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import NamedTuple

from twin.kernel.cosim.component import Component, NativeComponent
from twin.kernel.cosim.subsystem import INLET_NAME, Subsystem
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.fmi.description import KIND_NAMES, FmuDescription
from twin.kernel.fmi.variable import FilePath, Setting, Variable
from twin.robot.assembly.assemble import IN_PROCESS_MAKER
from twin.robot.assembly.build import (
    Build,
    drives_all_joints,
    joint_drives,
    need_processes,
    planned_drives,
    resting_plant,
    unpowered_shafts,
)
from twin.robot.assembly.drives import DrivePlan, rates
from twin.robot.experiment.experiment import Experiment

REAL_TYPES = ("Real", "Float64", "Float32")


class Socket(NamedTuple):
    """An FMU variable in an exported system, with its conversion: SI value = gain * value + offset."""

    element: str
    variable: str
    gain: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Element:
    """An FMU of a drive in an exported system, or one of twin's own components around it, such as "drive_1".

    Attributes:
        part: name of the part within the drive; "" if the drive is a single FMU.
        settings: values of an FMU's parameters and start values of its inputs, in its own units.
        variables: variables of an FMU that have a role.
        starts: start values of the inputs of one of twin's own components.
    """

    name: str
    part: str
    content: FmuDescription | NativeComponent
    settings: tuple[Setting, ...] = ()
    variables: tuple[Variable, ...] = ()
    starts: tuple[float, ...] = ()


@dataclass(frozen=True)
class JointDrive:
    """The drive of one joint in an exported system: elements in the order of a tick, connections (from, to).

    Attributes:
        inputs: port of the drive, e.g. `omega_ref` -> the sockets it feeds.
        theta_m: the angle of the shaft.
    """

    elements: tuple[Element, ...]
    connections: tuple[tuple[Socket, Socket], ...]
    inputs: Mapping[str, tuple[Socket, ...]]
    theta_m: Socket


def travelling_drives(experiment: Experiment) -> tuple[JointDrive, ...]:
    """Return the drives of the three joints for export; refuse those that depend on twin's own master."""
    plans = planned_drives(experiment)
    if experiment.monitor is not None:
        plans = tuple(plan.with_enable_input() for plan in plans)
    for plan in plans:
        _refuse_unexportable(plan, experiment.cosim.tick)
    if need_processes(plans):
        raise InputRefused(
            f"{plans[0].label}: can be instantiated only once per process, so that three joints need three processes, "
            "which an SSP cannot express; choose another drive"
        )
    plant, theta_m = resting_plant(experiment)
    build = Build(experiment, plans, IN_PROCESS_MAKER, plant, theta_m)
    with ExitStack() as made:
        components = []
        for make in joint_drives(build).values():
            components.append(make())
            made.callback(components[-1].close)
        joints = tuple(_joint_drive(c, plan) for c, plan in zip(components, plans, strict=True))
    shafts = unpowered_shafts(build).values()
    return (
        tuple(_with_unpowered_shaft(joint, make()) for joint, make in zip(joints, shafts, strict=True))
        if shafts
        else joints
    )


def _with_unpowered_shaft(joint: JointDrive, shaft: Component) -> JointDrive:
    """Return an exported joint drive with a component for its shaft without power appended."""
    name = f"drive_{shaft.name.rpartition('_')[2]}_unpowered"
    starts = (float(shaft.initial("theta_m")[0]), 0.0, 1.0, 0.0)
    own = {port.name: Socket(name, port.name) for port in shaft.inputs}
    return JointDrive(
        (*joint.elements, _own_element(name, shaft, starts)),
        (*joint.connections, (joint.theta_m, own["theta_m"])),
        {
            **joint.inputs,
            "tau_load": (*joint.inputs.get("tau_load", ()), own["tau_load"]),
            "power": (own["power"],),
            "brake": (own["brake"],),
        },
        Socket(name, f"{shaft.name}.theta_m"),
    )


def _refuse_unexportable(plan: DrivePlan, tick: float) -> None:
    label = plan.label
    if plan.system is not None:
        raise InputRefused(f"{label}: is an SSP itself, which is not taken apart; `twin drive new` makes parts of it")
    if drives_all_joints(plan):
        raise InputRefused(f"{label}: drives all three joints by arrays, which SSP 1.0 lacks; choose another drive")
    for fmu in plan.parts.values():
        if fmu.kind != "co_simulation":
            raise InputRefused(
                f"{label}: is used for {KIND_NAMES[fmu.kind]}, with a solver of twin; an SSP needs an FMU for "
                "co-simulation"
            )
    substeps, _ = rates("drive", plan.table, tick)
    if substeps > 1:
        loop = next((name for name in ("velocity_loop", "position_command") if getattr(plan.table, name)), "")
        why = f"twin's [drive.{loop}] acts in each of them" if loop else "[drive] substeps requires them"
        raise InputRefused(
            f"{label}: makes {substeps} steps in a tick of {1e3 * tick:g} ms, as {why}; an SSP has one step for all. "
            "Choose another drive, or a cosim.tick_ms as short as these steps"
        )
    if plan.table.tolerance is not None:
        raise InputRefused(f"{label}: [drive] tolerance cannot be expressed in an SSP; remove it")
    for settings in plan.settings.values():
        for variable, value in settings:
            if isinstance(value, list) and any(isinstance(text, FilePath) for text in value):
                raise InputRefused(f"{label}: its parameter {variable.name} is a file, which an SSP cannot include")
            if variable.size > 1:
                raise InputRefused(f"{label}: its parameter {variable.name} is an array, which SSP 1.0 does not have")


def _joint_drive(component: Component, plan: DrivePlan) -> JointDrive:
    if isinstance(component, FmuComponent):
        element = _fmu_element(component.name, "", component, plan)
        taken = {port.name: (_input(component, component.name, port.name),) for port in component.inputs}
        return JointDrive((element,), (), taken, _output(component, component.name, "theta_m"))
    assert isinstance(component, Subsystem)
    inside = {part.name: part for part in component.system.components if part.name != INLET_NAME}
    alone = sum(isinstance(part, FmuComponent) for part in inside.values()) == 1
    names = {
        name: component.name if alone and isinstance(part, FmuComponent) else f"{component.name}_{name}"
        for name, part in inside.items()
    }
    initial = component.system.outputs()
    fed = {target: initial[component.system.columns(source)] for source, target in component.wires}
    elements = [
        _fmu_element(names[name], "" if alone else name, part, plan)
        if isinstance(part, FmuComponent)
        else _own_element(names[name], part, [float(fed[f"{name}.{port.name}"][0]) for port in part.inputs])
        for name, part in inside.items()
    ]
    connections: list[tuple[Socket, Socket]] = []
    inputs: dict[str, tuple[Socket, ...]] = {}
    for source, target in component.wires:
        (giver, output), (taker, port) = source.split(".", 1), target.split(".", 1)
        to = _input(inside[taker], names[taker], port)
        if giver == INLET_NAME:
            inputs[output] = (*inputs.get(output, ()), to)
        else:
            connections.append((_output(inside[giver], names[giver], output), to))
    name, output = component.outlets["theta_m"].split(".", 1)
    return JointDrive(tuple(elements), tuple(connections), inputs, _output(inside[name], names[name], output))


def _fmu_element(name: str, part: str, component: FmuComponent, plan: DrivePlan) -> Element:
    inputs, outputs = component.ports
    variables = [p.variable for p in inputs] + [placed.port.variable for placed in outputs]
    for variable in variables:
        if variable.size > 1:
            raise InputRefused(
                f"{plan.label}: {variable.name} is an array, which SSP 1.0 does not have; choose another drive"
            )
    for p in inputs:
        if p.variable.type not in REAL_TYPES:
            raise InputRefused(
                f"{plan.label}: its input {p.variable.name} is of type {p.variable.type}, and its source is real; "
                "an SSP does not round. Choose another drive"
            )
    return Element(
        name=name,
        part=part,
        content=component.instance.description,
        settings=tuple({s[0].name: s for s in (*plan.settings[part], *component.instance.inputs)}.values()),
        variables=tuple(dict.fromkeys(variables)),
    )


def _own_element(name: str, component: Component, starts: Sequence[float]) -> Element:
    assert isinstance(component, NativeComponent)
    return Element(name, component.name, component, starts=tuple(starts))


def _input(component: Component, element: str, name: str) -> Socket:
    if not isinstance(component, FmuComponent):
        return Socket(element, name)
    port = next(p for p in component.ports[0] if p.port.name == name)
    return Socket(element, port.variable.name, port.gain, port.offset)


def _output(component: Component, element: str, name: str) -> Socket:
    if not isinstance(component, FmuComponent):
        return Socket(element, f"{component.name}.{name}")
    found = next(placed for placed in component.ports[1] if placed.port.port.name == name)
    return Socket(element, found.port.variable.name, found.port.gain, found.port.offset + float(found.shift[0]))
