"""The SSP structure of an experiment's robot: parts, drives, connections."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version

from twin.kernel.ssp import structure as ssp
from twin.robot.assembly.assemble import BRAKE_SOURCES, COMMAND_SOURCES, DRIVE_POWER_SOURCES, POWER_SOURCES
from twin.robot.experiment.experiment import Experiment
from twin.studies.build.joint_drive import JointDrive, Socket
from twin.studies.build.parameter_values import ConnectorUnit, unambiguous_units

BUILD_NAMESPACE = "urn:twin:build"
OPEN_MODELICA = "https://raw.githubusercontent.com/OpenModelica/OMSimulator/master/schema/oms.xsd"
RECORDED_PACKAGES = ("twin", "numba", "llvmlite", "numpy")
LINE_SOURCES = {
    "omega_ref": COMMAND_SOURCES,
    "power": POWER_SOURCES,
    "drive_power": DRIVE_POWER_SOURCES,
    "brake": BRAKE_SOURCES,
}
ET.register_namespace("twin", BUILD_NAMESPACE)
ET.register_namespace("oms", OPEN_MODELICA)


@dataclass(frozen=True)
class Member:
    """An element of an exported SSP system: archive path of its FMU, and a description in one sentence."""

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
    """Return the complete SSP structure of the robot: elements, connectors, connections, annotations.

    Members are in the order of a Gauss-Seidel master; hashes are SHA-256 by entry of the archive.
    """
    units = unambiguous_units(unit for member in members for _, unit in member.connectors)
    tick, duration = experiment.cosim.tick, experiment.duration_ticks * experiment.cosim.tick
    system = ssp.SspSystem(
        name=experiment.name,
        elements=tuple(_component(member, units) for member in members),
        connections=tuple(_connections(members, drives)),
        description=experiment.title,
        # OMSimulator reads only the first annotation, and rejects files with one outside of the system
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
    last = {name: _first_available(given, sources) for name, sources in LINE_SOURCES.items()}
    for member in ours:
        for connector, _ in member.connectors:
            if connector.kind == "input":
                yield _connection(_feeding_socket(connector.name, given, drives), Socket(member.name, connector.name))
    for number, drive in enumerate(drives, start=1):
        for source, target in drive.connections:
            yield _connection(source, target)
        fed = {"omega_ref": f"{last['omega_ref']}[{number}]", "tau_load": f"plant.tau_load[{number}]"}
        fed |= {"enable": last["power"], "brake": last["brake"]}
        if last["drive_power"]:
            fed["enable"] = fed["power"] = f"{last['drive_power']}[{number}]"
        for port, sockets in drive.inputs.items():
            for socket in sockets:
                yield _connection(given[fed[port]], socket)


def _feeding_socket(name: str, given: Mapping[str, Socket], drives: Sequence[JointDrive]) -> Socket:
    """Return the variable that feeds an input of one of twin's own parts in an SSP."""
    port, bracket, number = name.removesuffix("]").partition("[")
    if port == "theta_m":
        return drives[int(number) - 1].theta_m
    # the bus itself reads the source before it in the list
    sources = ("plant.theta_l",) if port == "theta_l" else LINE_SOURCES[port][1:]
    return given[_first_available(given, sources) + (f"[{number}]" if bracket else "")]


def _first_available(given: Mapping[str, Socket], sources: Sequence[str]) -> str:
    """Return the first of several sources that an exported part has, as a whole or by elements; "" without any."""
    return next((name for name in sources if name in given or f"{name}[1]" in given), "")


def _connection(source: Socket, target: Socket) -> ssp.Connection:
    factor, offset = source.gain / target.gain, (source.offset - target.offset) / target.gain
    line = ssp.Transformation(factor, offset)
    ends = ssp.Endpoint(source.element, source.variable), ssp.Endpoint(target.element, target.variable)
    # a tool that also converted the units would apply the conversion twice
    return ssp.Connection(*ends, line, suppress_unit_conversion=line != ssp.Transformation())


def _fixed_steps(tick: float) -> str:
    """Return the SSP annotation that asks OMSimulator for a fixed-step master, which SSP itself cannot express."""
    root = ET.Element(f"{{{OPEN_MODELICA}}}Annotations")
    about = ET.SubElement(root, f"{{{OPEN_MODELICA}}}SimulationInformation")
    steps = {"description": "oms-ma", "stepSize": repr(tick), "absoluteTolerance": "1e-4", "relativeTolerance": "1e-4"}
    ET.SubElement(about, f"{{{OPEN_MODELICA}}}FixedStepMaster", steps)
    return ET.tostring(root, encoding="unicode")


def _provenance(experiment: Experiment, hashes: Mapping[str, str]) -> str:
    """Return the SSP annotation about sources and software of the build and twin's coupling scheme."""
    cosim = experiment.cosim
    stated = {"experiment": experiment.name, "scheme": cosim.scheme, "stepSize": repr(cosim.tick)}
    root = ET.Element(f"{{{BUILD_NAMESPACE}}}Build", stated)
    for entry, digest in hashes.items():
        ET.SubElement(root, f"{{{BUILD_NAMESPACE}}}File", source=entry, sha256=digest)
    for package in RECORDED_PACKAGES:
        ET.SubElement(root, f"{{{BUILD_NAMESPACE}}}Software", name=package, version=version(package))
    return ET.tostring(root, encoding="unicode")
