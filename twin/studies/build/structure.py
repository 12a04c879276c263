"""The SSP structure of an experiment's robot: parts, drives, connections.

What parts of ours and FMUs of others have in common in an SSP: units by their names, and where values come from.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version

import numpy as np

from twin.kernel.fmi.description import FmuDescription
from twin.kernel.fmi.variable import Setting, Variable
from twin.kernel.ssp.structure import (
    Annotation,
    Connection,
    Connector,
    ConnectorKind,
    DefaultExperiment,
    Endpoint,
    Metadata,
    ParameterBinding,
    ParameterSet,
    ParameterValue,
    SspComponent,
    SspSystem,
    Structure,
    Transformation,
    UnitDefinition,
)
from twin.kernel.units import Dimension, known_unit
from twin.robot.assembly.assemble import COMMAND, POWER
from twin.robot.experiment.experiment import Experiment
from twin.studies.build.drives import JointDrive, Socket

ConnectorUnit = tuple[Connector, UnitDefinition | None]
"""A connector, and the unit that it names."""
FROM_ROBOT = ("plant", "controller.model")
"""Tables that the robot's own fills where they say nothing."""


def defined(units: Iterable[UnitDefinition | None]) -> dict[str, UnitDefinition]:
    """Units of one file by their names; where two mean different things by one name, it is ambiguous."""
    found: dict[str, UnitDefinition] = {}
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
        name: of the element.
        about: what it is, one sentence.
        entry: of the archive, its FMU.
        connectors: of it.
        values: that it is set to.
    """

    name: str
    about: str
    entry: str
    connectors: tuple[ConnectorUnit, ...]
    values: ParameterSet | None


def structure(
    experiment: Experiment,
    members: Sequence[Member],
    drives: Sequence[JointDrive],
    hashes: Mapping[str, str],
    metadata: Metadata,
) -> Structure:
    """The whole of it.

    Args:
        experiment: that is built.
        members: elements in the order in which a Gauss-Seidel master steps them.
        drives: of the joints.
        hashes: SHA-256 by entry of the archive.
        metadata: of the file.
    """
    units = defined(unit for member in members for _, unit in member.connectors)
    tick, duration = experiment.cosim.tick, experiment.duration_ticks * experiment.cosim.tick
    system = SspSystem(
        name=experiment.name,
        elements=tuple(_component(member, units) for member in members),
        connections=tuple(_connections(members, drives)),
        description=experiment.title,
        # OMSimulator reads the first one, and no file with one outside of the system
        annotations=(
            Annotation("org.openmodelica", _fixed_steps(tick)),
            Annotation("twin", _provenance(experiment, hashes)),
        ),
    )
    return Structure(
        name=experiment.name,
        system=system,
        units=tuple(units.values()),
        experiment=DefaultExperiment(0.0, duration),
        metadata=metadata,
    )


def _component(member: Member, units: Mapping[str, UnitDefinition]) -> SspComponent:
    connectors = (c if c.unit in units else replace(c, unit="") for c, _ in member.connectors)
    return SspComponent(
        name=member.name,
        source=member.entry,
        implementation="CoSimulation",
        connectors=tuple(connectors),
        bindings=() if member.values is None else (ParameterBinding(member.values),),
        description=member.about,
    )


def _connections(members: Sequence[Member], drives: Sequence[JointDrive]) -> Iterator[Connection]:
    ours = [member for member in members if not member.name.startswith("drive_")]
    given = {c.name: Socket(member.name, c.name) for member in ours for c, _ in member.connectors if c.kind == "output"}
    last = {name: _last(given, sources) for name, sources in (("omega_ref", COMMAND), ("enable", POWER))}
    for member in ours:
        for connector, _ in member.connectors:
            if connector.kind == "input":
                yield _joined(_feeding(connector.name, given, drives), Socket(member.name, connector.name))
    for number, drive in enumerate(drives, start=1):
        for source, target in drive.connections:
            yield _joined(source, target)
        fed = {"omega_ref": f"{last['omega_ref']}[{number}]", "tau_load": f"plant.tau_load[{number}]"}
        fed["enable"] = last["enable"]
        for port, sockets in drive.inputs.items():
            for socket in sockets:
                yield _joined(given[fed[port]], socket)


def _feeding(name: str, given: Mapping[str, Socket], drives: Sequence[JointDrive]) -> Socket:
    """What feeds an input of a part of ours."""
    port, bracket, number = name.removesuffix("]").partition("[")
    if port == "theta_m":
        return drives[int(number) - 1].theta_m
    # what the bus takes is what is in front of it
    sources = {"theta_l": ("plant.theta_l",), "omega_ref": COMMAND[1:], "power": POWER[1:]}[port]
    return given[_last(given, sources) + (f"[{number}]" if bracket else "")]


def _last(given: Mapping[str, Socket], sources: Sequence[str]) -> str:
    """The first of `sources` that is there, as a whole or by its elements; "" if none is."""
    return next((name for name in sources if name in given or f"{name}[1]" in given), "")


def _joined(source: Socket, target: Socket) -> Connection:
    factor, offset = source.gain / target.gain, (source.offset - target.offset) / target.gain
    line = Transformation(factor, offset)
    ends = Endpoint(source.element, source.variable), Endpoint(target.element, target.variable)
    # a line does all of it: a tool that converts units as well would do it twice
    return Connection(*ends, line, suppress_unit_conversion=line != Transformation())


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
THEIRS: dict[str, ConnectorKind] = {
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
        connector = Connector(v.name, THEIRS[v.causality], type_, unit.name if unit else "", (), v.description)
        found.append((connector, unit))
    return tuple(found)


def foreign_values(
    experiment: Experiment,
    name: str,
    table: str,
    description: FmuDescription,
    settings: Sequence[Setting],
    source: str,
    metadata: Metadata,
) -> ParameterSet:
    """What an FMU of a drive is set to before it is initialised.

    Args:
        experiment: whose values they are.
        name: of the element.
        table: of the experiment that says its parameters, "drive.parameters".
        description: of the FMU.
        settings: in its own units.
        source: entry of the archive.
        metadata: of the file.
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
        values.append(ParameterValue(variable.name, kind, (_plain(variable, kind, value),), named, stated))  # type: ignore[arg-type]
    return ParameterSet(name, tuple(values), tuple(units.values()), source, metadata)


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


def _unit(variable: Variable, description: FmuDescription) -> UnitDefinition | None:
    """What its values are in; None: not stated."""
    text = variable.unit
    if not text or _type(variable) != "Real":
        return None
    for stated in description.model.unitDefinitions:
        if stated.name == text and stated.baseUnit is not None:
            base = stated.baseUnit
            powers = Dimension(*(int(getattr(base, name) or 0) for name in Dimension._fields))
            return UnitDefinition(text, powers, float(base.factor), float(base.offset))
    known = known_unit(text)
    return None if known is None else UnitDefinition(text, known.dimension, known.scale)
