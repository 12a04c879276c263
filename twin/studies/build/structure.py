"""The robot of an experiment as the structure of an SSP: its parts, the drives, and what leads where.

What parts of ours and FMUs of others have in common in an SSP: units by their names, and where values come from.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.metadata import version

from twin.kernel.ssp.parameters import (
    Annotation,
    Metadata,
    ParameterBinding,
    ParameterSet,
    Transformation,
    UnitDefinition,
)
from twin.kernel.ssp.structure import Connection, Connector, DefaultExperiment, End, SspComponent, SspSystem, Structure
from twin.robot.assembly.assemble import COMMAND, POWER
from twin.robot.experiment.experiment import Experiment
from twin.studies.build.drives import JointDrive, Socket

Told = tuple[Connector, UnitDefinition | None]
"""A connector, and the unit that it names."""
FROM_ROBOT = ("plant", "controller.model")
"""Tables that the robot's own fills where they say nothing."""


def defined(units: Iterable[UnitDefinition | None]) -> dict[str, UnitDefinition]:
    """Units of one file by their names; where two mean different things by one name, it is nobody's."""
    found: dict[str, UnitDefinition] = {}
    disputed: set[str] = set()
    for unit in units:
        if unit is not None and found.setdefault(unit.name, unit) != unit:
            disputed.add(unit.name)
    return {name: unit for name, unit in sorted(found.items()) if name not in disputed}


def origin(experiment: Experiment, key: str) -> str:
    """Where the value of a key of the experiment's file comes from; "" if nobody says."""
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
    connectors: tuple[Told, ...]
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
    ends = End(source.element, source.variable), End(target.element, target.variable)
    # a line does all of it: whoever converts units as well would do it twice
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
