"""The drives of an experiment for export: their FMUs as delivered, and adapters of ours around them.

The master of a system of FMUs makes one step of all of them in each tick; a drive travels if that is all it needs.

What of an experiment cannot be built, and why.
"""

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from typing import NamedTuple

from twin.kernel.cosim.component import Component, NativeComponent
from twin.kernel.cosim.subsystem import INLET, Subsystem
from twin.kernel.cosim.system import Feeds
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.fmi.description import KIND_NAMES, FmuDescription
from twin.kernel.fmi.variable import FilePath, Setting, Variable
from twin.robot.assembly.assemble import HERE
from twin.robot.assembly.build import Build, at_rest, joint_drives, motions, need_processes, planned_drives, turns_all
from twin.robot.assembly.declared import BROKEN, PLACES
from twin.robot.assembly.drives import DrivePlan, rates
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import CATALOGUE


def refuse_others(experiment: Experiment, name: str, wanted: Sequence[str]) -> None:
    """Refuse what is not twin's own, or is nothing that a master could step.

    Args:
        experiment: whose part `name` it is.
        wanted: the components of the part.

    Raises:
        InputRefused: it is.
    """
    if name.startswith("drive"):
        raise InputRefused(f"{name}: a drive is an FMU already; expected another part of {experiment.name}")
    for role in wanted:
        # the body's values come in from outside then
        if role in experiment.stand_ins and name != "plant":
            label = experiment.stand_ins[role].label
            raise InputRefused(
                f"{experiment.name}: its {role} is {label}; it is third-party, and only twin's own can be built"
            )
    if "plant" in wanted and experiment.cosim.inputs == "linear":
        raise InputRefused(
            f'{experiment.name}: [cosim] inputs = "linear": an FMU holds its inputs over a step; '
            "build the plant with --set cosim.inputs=hold"
        )
    if name == "body" and not motions(experiment):
        raise InputRefused(f"{experiment.name}: its body does not move; there is nothing to build")
    for number, fault in enumerate(experiment.faults, start=1):
        if name == f"fault_{number}":
            _refuse_alone(name, fault.kind)


def _refuse_alone(name: str, kind: str) -> None:
    """A fault that is no component between wires."""
    if kind in BROKEN:
        owner = BROKEN[kind].component
        raise InputRefused(
            f"{name}: {kind} writes into the memory of {owner}, which no FMU can do to another; it cannot be built"
        )
    if CATALOGUE[kind].mechanism == "body":
        raise InputRefused(f"{name}: {kind} is a motion of the body, and is built with it: expected body or plant")


def refuse_changed(experiment: Experiment, wanted: Sequence[str]) -> None:
    """Refuse components that the experiment itself changes on the way.

    Raises:
        InputRefused: it does.
    """
    for change in experiment.changes:
        if PLACES[change.key].component in wanted:
            raise InputRefused(
                f"{experiment.name}: has [[change]] tables, which cannot be built; build it with --set change=[], and "
                f"set {change.key} at that time in the other master"
            )


def refuse_broken(experiment: Experiment, name: str, wanted: Sequence[str], sound: Feeds, feeds: Feeds) -> None:
    """Refuse a part within which something breaks: a fault is a part of its own.

    Args:
        experiment: whose part `name` it is.
        wanted: the components of the part.
        sound, feeds: what joins all components without faults, and with them.

    Raises:
        InputRefused: a fault acts within the part.
    """
    instead = f"or build the sound {name} with --set fault=[]"
    for target, source in sound.items():
        if feeds[target] != source and {target.component, source.component} <= set(wanted):
            fault = feeds[target].component
            kind = experiment.faults[int(fault.rpartition("_")[2]) - 1].kind
            apart = ", ".join([*wanted, fault])
            raise InputRefused(
                f"{experiment.name}: {fault} ({kind}) stands between {source.component} and {target.component}, within "
                f"{name}; build its components one by one ({apart}), {instead}"
            )
    for number, fault_ in enumerate(experiment.faults, start=1):
        if fault_.kind in BROKEN and (owner := BROKEN[fault_.kind].component) in wanted:
            raise InputRefused(
                f"{experiment.name}: fault_{number} ({fault_.kind}) writes into the memory of {owner}, which no FMU "
                f"can do to another; expected faults between parts, {instead}"
            )


REALS = ("Real", "Float64", "Float32")


class Socket(NamedTuple):
    """A variable of an element of the system, and what the robot takes it for: SI value = gain * value + offset."""

    element: str
    variable: str
    gain: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Element:
    """An FMU of a drive, or a component of ours around it.

    Attributes:
        name: in the system, "drive_1".
        part: of the drive, "" if it is but one FMU.
        content: what it is.
        settings: of an FMU, in its own units: values of parameters, and of inputs at the start.
        variables: of an FMU, that have a role.
        starts: of a component of ours, by input, at the start.
    """

    name: str
    part: str
    content: FmuDescription | NativeComponent
    settings: tuple[Setting, ...] = ()
    variables: tuple[Variable, ...] = ()
    starts: tuple[float, ...] = ()


@dataclass(frozen=True)
class JointDrive:
    """What drives a joint.

    Attributes:
        elements: in the order of a tick.
        connections: between them, (from, to).
        inputs: by the port of the drive, `omega_ref`, what it feeds.
        theta_m: the angle of its shaft.
    """

    elements: tuple[Element, ...]
    connections: tuple[tuple[Socket, Socket], ...]
    inputs: Mapping[str, tuple[Socket, ...]]
    theta_m: Socket


def travelling_drives(experiment: Experiment) -> tuple[JointDrive, ...]:
    """The drives of the three joints.

    Raises:
        InputRefused: a drive cannot be used, or one needs more than a step of its FMUs in each tick.
    """
    plans = planned_drives(experiment)
    if experiment.monitor is not None:
        plans = tuple(plan.switchable() for plan in plans)
    for plan in plans:
        _refuse_bound(plan, experiment.cosim.tick)
    if need_processes(plans):
        raise InputRefused(
            f"{plans[0].label}: can be instantiated only once in a process, so that three of it take three processes, "
            "which an SSP cannot ask for; choose another drive"
        )
    plant, theta_m = at_rest(experiment)
    build = Build(experiment, plans, HERE, plant, theta_m)
    with ExitStack() as made:
        components = []
        for make in joint_drives(build).values():
            components.append(make())
            made.callback(components[-1].close)
        return tuple(_joint_drive(c, plan) for c, plan in zip(components, plans, strict=True))


def _refuse_bound(plan: DrivePlan, tick: float) -> None:
    """Refuse a drive that cannot leave our master."""
    label = plan.label
    if turns_all(plan):
        raise InputRefused(f"{label}: drives all three joints by arrays, which SSP 1.0 lacks; choose another drive")
    for fmu in plan.parts.values():
        if fmu.kind != "co_simulation":
            raise InputRefused(
                f"{label}: is used for {KIND_NAMES[fmu.kind]}, whose solver here is ours; an SSP takes an FMU for "
                "co-simulation"
            )
    substeps, _ = rates("drive", plan.table, tick)
    if substeps > 1:
        loop = next((name for name in ("velocity_loop", "position_command") if getattr(plan.table, name)), "")
        why = f"[drive.{loop}] of ours acts in each of them" if loop else "[drive] substeps asks for them"
        raise InputRefused(
            f"{label}: makes {substeps} steps in a tick of {1e3 * tick:g} ms, as {why}; an SSP has one step for all. "
            "Choose another drive, or a cosim.tick_ms as short as these steps"
        )
    if plan.table.tolerance is not None:
        raise InputRefused(f"{label}: [drive] tolerance cannot be expressed in an SSP; remove it")
    for settings in plan.settings.values():
        for variable, value in settings:
            if isinstance(value, list) and any(isinstance(text, FilePath) for text in value):
                raise InputRefused(f"{label}: its parameter {variable.name} is a file, which an SSP cannot take along")
            if variable.size > 1:
                raise InputRefused(f"{label}: its parameter {variable.name} is an array, which SSP 1.0 does not have")


def _joint_drive(component: Component, plan: DrivePlan) -> JointDrive:
    if isinstance(component, FmuComponent):
        element = _fmu_element(component.name, "", component, plan)
        taken = {port.name: (_input(component, component.name, port.name),) for port in component.inputs}
        return JointDrive((element,), (), taken, _output(component, component.name, "theta_m"))
    assert isinstance(component, Subsystem)
    inside = {part.name: part for part in component.system.components if part.name != INLET}
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
        if giver == INLET:
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
        if p.variable.type not in REALS:
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
