"""The SSP structure of an experiment's robot: parts, drives, connections.

What parts of ours and FMUs of others have in common in an SSP: units by their names, and where values come from.

The drives of an experiment for export: their FMUs as delivered, and adapters of ours around them.

The master of a system of FMUs makes one step of all of them in each tick; a drive travels if that is all it needs.

What of an experiment cannot be built, and why.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from importlib.metadata import version
from typing import NamedTuple

import numpy as np

from twin.kernel.cosim.component import Component, NativeComponent
from twin.kernel.cosim.subsystem import INLET, Subsystem
from twin.kernel.cosim.system import Feeds
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.fmi.description import KIND_NAMES, FmuDescription
from twin.kernel.fmi.variable import FilePath, Setting, Variable
from twin.kernel.ssp import structure as ssp
from twin.kernel.units import Dimension, known_unit
from twin.robot.assembly.assemble import BRAKE, COMMAND, DRIVE_POWER, HERE, POWER
from twin.robot.assembly.build import (
    Build,
    at_rest,
    joint_drives,
    motions,
    need_processes,
    planned_drives,
    turns_all,
    unpowered_shafts,
)
from twin.robot.assembly.declared import BROKEN, PLACES
from twin.robot.assembly.drives import DrivePlan, rates
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import CATALOGUE


def refuse_others(experiment: Experiment, name: str, wanted: Sequence[str]) -> None:
    """Refuse what is not twin's own, or is nothing that a master could step."""
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
    """Refuse components that the experiment itself changes on the way."""
    for change in experiment.changes:
        if PLACES[change.key].component in wanted:
            raise InputRefused(
                f"{experiment.name}: has [[change]] tables, which cannot be built; build it with --set change=[], and "
                f"set {change.key} at that time in the other master"
            )


def refuse_broken(experiment: Experiment, name: str, wanted: Sequence[str], sound: Feeds, feeds: Feeds) -> None:
    """Refuse a part within which something breaks: a fault is a part of its own.

    Args:
        sound, feeds: what joins all components without faults, and with them.
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
    """The drives of the three joints."""
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
        joints = tuple(_joint_drive(c, plan) for c, plan in zip(components, plans, strict=True))
    shafts = unpowered_shafts(build).values()
    return tuple(_behind(joint, make()) for joint, make in zip(joints, shafts, strict=True)) if shafts else joints


def _behind(joint: JointDrive, shaft: Component) -> JointDrive:
    """`joint` with what its shaft does without power, which is what all others see of it."""
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


def _refuse_bound(plan: DrivePlan, tick: float) -> None:
    """Refuse a drive that cannot leave our master."""
    label = plan.label
    if plan.system is not None:
        raise InputRefused(f"{label}: is an SSP itself, which is not taken apart; `twin drive new` makes parts of it")
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


ConnectorUnit = tuple[ssp.Connector, ssp.UnitDefinition | None]
"""A connector, and the unit that it names."""
FROM_ROBOT = ("plant", "controller.model")
"""Tables that the robot's own fills where they say nothing."""


def defined(units: Iterable[ssp.UnitDefinition | None]) -> dict[str, ssp.UnitDefinition]:
    """Units of one file by their names; where two mean different things by one name, it is ambiguous."""
    found: dict[str, ssp.UnitDefinition] = {}
    disputed: set[str] = set()
    for unit in units:
        if unit is not None and found.setdefault(unit.name, unit) != unit:
            disputed.add(unit.name)
    return {name: unit for name, unit in sorted(found.items()) if name not in disputed}


def origin(experiment: Experiment, key: str) -> str:
    """Where the value of a key of the experiment's file comes from; "" if not stated."""
    for table in FROM_ROBOT:
        if key.startswith(f"{table}.") and key not in experiment.origins:
            key = f"robot{key.removeprefix(table)}"
    return experiment.origins.get(key, "")


OURS = "urn:twin:build"
OPEN_MODELICA = "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd"
PACKAGES = ("twin", "numba", "llvmlite", "numpy")
ET.register_namespace("twin", OURS)
ET.register_namespace("oms", OPEN_MODELICA)


@dataclass(frozen=True)
class Member:
    """An element of the system.

    Attributes:
        about: what it is, one sentence.
        entry: of the archive, its FMU.
    """

    name: str
    about: str
    entry: str
    connectors: tuple[ConnectorUnit, ...]
    values: ssp.ParameterSet | None


def structure(
    experiment: Experiment,
    members: Sequence[Member],
    drives: Sequence[JointDrive],
    hashes: Mapping[str, str],
    metadata: ssp.Metadata,
) -> ssp.Structure:
    """The whole of it.

    Args:
        members: elements in the order in which a Gauss-Seidel master steps them.
        hashes: SHA-256 by entry of the archive.
    """
    units = defined(unit for member in members for _, unit in member.connectors)
    tick, duration = experiment.cosim.tick, experiment.duration_ticks * experiment.cosim.tick
    system = ssp.SspSystem(
        name=experiment.name,
        elements=tuple(_component(member, units) for member in members),
        connections=tuple(_connections(members, drives)),
        description=experiment.title,
        # OMSimulator reads the first one, and no file with one outside of the system
        annotations=(
            ssp.Annotation("org.openmodelica", _fixed_steps(tick)),
            ssp.Annotation("twin", _provenance(experiment, hashes)),
        ),
    )
    return ssp.Structure(
        name=experiment.name,
        system=system,
        units=tuple(units.values()),
        experiment=ssp.DefaultExperiment(0.0, duration),
        metadata=metadata,
    )


def _component(member: Member, units: Mapping[str, ssp.UnitDefinition]) -> ssp.SspComponent:
    connectors = (c if c.unit in units else replace(c, unit="") for c, _ in member.connectors)
    return ssp.SspComponent(
        name=member.name,
        source=member.entry,
        implementation="CoSimulation",
        connectors=tuple(connectors),
        bindings=() if member.values is None else (ssp.ParameterBinding(member.values),),
        description=member.about,
    )


def _connections(members: Sequence[Member], drives: Sequence[JointDrive]) -> Iterator[ssp.Connection]:
    ours = [member for member in members if not member.name.startswith("drive_")]
    given = {c.name: Socket(member.name, c.name) for member in ours for c, _ in member.connectors if c.kind == "output"}
    lines = {"omega_ref": COMMAND, "enable": POWER, "power": DRIVE_POWER, "brake": BRAKE}
    last = {name: _last(given, sources) for name, sources in lines.items()}
    for member in ours:
        for connector, _ in member.connectors:
            if connector.kind == "input":
                yield _joined(_feeding(connector.name, given, drives), Socket(member.name, connector.name))
    for number, drive in enumerate(drives, start=1):
        for source, target in drive.connections:
            yield _joined(source, target)
        fed = {"omega_ref": f"{last['omega_ref']}[{number}]", "tau_load": f"plant.tau_load[{number}]"}
        fed |= {"enable": last["enable"], "brake": last["brake"]}
        if last["power"]:
            fed["enable"] = fed["power"] = f"{last['power']}[{number}]"
        for port, sockets in drive.inputs.items():
            for socket in sockets:
                yield _joined(given[fed[port]], socket)


def _feeding(name: str, given: Mapping[str, Socket], drives: Sequence[JointDrive]) -> Socket:
    """What feeds an input of a part of ours."""
    port, bracket, number = name.removesuffix("]").partition("[")
    if port == "theta_m":
        return drives[int(number) - 1].theta_m
    # what the bus takes is what is in front of it
    lines = {"omega_ref": COMMAND, "power": POWER, "drive_power": DRIVE_POWER, "brake": BRAKE}
    sources = ("plant.theta_l",) if port == "theta_l" else lines[port][1:]
    return given[_last(given, sources) + (f"[{number}]" if bracket else "")]


def _last(given: Mapping[str, Socket], sources: Sequence[str]) -> str:
    """The first of `sources` that is there, as a whole or by its elements; "" if none is."""
    return next((name for name in sources if name in given or f"{name}[1]" in given), "")


def _joined(source: Socket, target: Socket) -> ssp.Connection:
    factor, offset = source.gain / target.gain, (source.offset - target.offset) / target.gain
    line = ssp.Transformation(factor, offset)
    ends = ssp.Endpoint(source.element, source.variable), ssp.Endpoint(target.element, target.variable)
    # a line does all of it: a tool that converts units as well would do it twice
    return ssp.Connection(*ends, line, suppress_unit_conversion=line != ssp.Transformation())


def _fixed_steps(tick: float) -> str:
    """What OMSimulator reads and writes of a master with fixed steps; SSP has no word for them."""
    root = ET.Element(f"{{{OPEN_MODELICA}}}Annotations")
    about = ET.SubElement(root, f"{{{OPEN_MODELICA}}}SimulationInformation")
    steps = {"description": "oms-ma", "stepSize": repr(tick), "absoluteTolerance": "1e-4", "relativeTolerance": "1e-4"}
    ET.SubElement(about, f"{{{OPEN_MODELICA}}}FixedStepMaster", steps)
    return ET.tostring(root, encoding="unicode")


def _provenance(experiment: Experiment, hashes: Mapping[str, str]) -> str:
    """What it was made of and by what, and in which scheme the twin runs it."""
    cosim = experiment.cosim
    stated = {"experiment": experiment.name, "scheme": cosim.scheme, "stepSize": repr(cosim.tick)}
    root = ET.Element(f"{{{OURS}}}Build", stated)
    for entry, digest in hashes.items():
        ET.SubElement(root, f"{{{OURS}}}File", source=entry, sha256=digest)
    for package in PACKAGES:
        ET.SubElement(root, f"{{{OURS}}}Software", name=package, version=version(package))
    return ET.tostring(root, encoding="unicode")


TYPES = {name: name for name in ("Real", "Boolean", "String", "Enumeration", "Binary")}
TYPES |= {"Float64": "Real", "Float32": "Real"}

# some tools leave their outputs marked as local
THEIRS: dict[str, ssp.ConnectorKind] = {
    "input": "input", "output": "output", "local": "output", "parameter": "parameter",
    "structuralParameter": "parameter",
}  # fmt: skip


def foreign_connectors(description: FmuDescription, variables: Sequence[Variable]) -> tuple[ConnectorUnit, ...]:
    """Of a third-party FMU, for some of its variables."""
    found = []
    for v in variables:
        kind, unit = _type(v), _unit(v, description)
        # which enumeration, the FMU tells
        type_ = "" if kind == "Enumeration" else kind
        connector = ssp.Connector(v.name, THEIRS[v.causality], type_, unit.name if unit else "", (), v.description)
        found.append((connector, unit))
    return tuple(found)


def foreign_values(
    experiment: Experiment,
    name: str,
    table: str,
    description: FmuDescription,
    settings: Sequence[Setting],
    source: str,
    metadata: ssp.Metadata,
) -> ssp.ParameterSet:
    """What an FMU of a drive is set to before it is initialised.

    Args:
        table: of the experiment that says its parameters, "drive.parameters".
        settings: in its own units.
        source: entry of the archive.
    """
    facts = {variable.name: (_type(variable), _unit(variable, description)) for variable, _ in settings}
    units = defined(unit for _, unit in facts.values())
    values = []
    for variable, value in settings:
        kind, unit = facts[variable.name]
        stated = origin(experiment, f"{table}.{variable.name}")
        if variable.causality == "input" and not stated:
            stated = "at the start of the experiment, the robot at rest"
        named = unit.name if unit is not None and unit.name in units else ""
        values.append(ssp.ParameterValue(variable.name, kind, (_plain(variable, kind, value),), named, stated))  # type: ignore[arg-type]
    return ssp.ParameterSet(name, tuple(values), tuple(units.values()), source, metadata)


def _plain(variable: Variable, kind: str, value: float | np.ndarray | list[str] | list[bytes]) -> float | str:
    """A value as a parameter set has it: texts, bytes in hexadecimal, items by their names."""
    one = value if isinstance(value, float) else value[0]
    if isinstance(one, bytes):
        return one.hex()
    if isinstance(one, str):
        return one
    return variable.format_value(float(one)) if kind == "Enumeration" else float(one)


def _type(variable: Variable) -> str:
    """As SSP 1.0 calls it; a whole number of FMI 3.0 is an Integer."""
    return TYPES.get(variable.type, "Integer")


def _unit(variable: Variable, description: FmuDescription) -> ssp.UnitDefinition | None:
    """What its values are in; None: not stated."""
    text = variable.unit
    if not text or _type(variable) != "Real":
        return None
    for stated in description.model.unitDefinitions:
        if stated.name == text and stated.baseUnit is not None:
            base = stated.baseUnit
            powers = Dimension(*(int(getattr(base, name) or 0) for name in Dimension._fields))
            return ssp.UnitDefinition(text, powers, float(base.factor), float(base.offset))
    known = known_unit(text)
    return None if known is None else ssp.UnitDefinition(text, known.dimension, known.scale)
