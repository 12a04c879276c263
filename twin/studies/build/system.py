"""The whole robot of an experiment as an SSP archive, with its README."""

import hashlib
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from twin.kernel.archive import zip_bytes
from twin.kernel.atomic_write import json_text, make_folder, refuse_unwritable, write_bytes
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.description import FmuDescription
from twin.kernel.ssp import structure as ssp
from twin.kernel.ssp.ssd import parameter_set_xml, structure_xml
from twin.robot.assembly.load import load_experiment
from twin.robot.experiment.experiment import Experiment
from twin.robot.run.run import without_folders
from twin.studies.build.fmu import RESULTS_FOLDER, pack_fmu, part_description, readme
from twin.studies.build.joint_drive import Element, JointDrive, travelling_drives
from twin.studies.build.layout import CAUSALITY_BY_KIND, ExportedVariable, layout_of
from twin.studies.build.linking import Platform, names_of, refuse_platform, select_platforms, summary
from twin.studies.build.parameter_values import (
    ConnectorUnit,
    foreign_connectors,
    foreign_values,
    origin,
    unambiguous_units,
)
from twin.studies.build.part import RobotPart, fixed_keys, open_parameters, part_of
from twin.studies.build.structure import Member, structure
from twin.studies.command import Answer

_SCHEME_TEXTS = {
    "gauss_seidel": (
        "Step the elements one after the other in this order, and pass the outputs of each on at once (Gauss-Seidel): "
        "the computer, the drives, the plant. The feedback signals (angles to the computer, load to the drives) have "
        "their values from before the step. This order reproduces the trace of the twin's own run. If all values are "
        "exchanged between steps (Jacobi), the computer's outputs arrive a tick later and the plant sees the drives' "
        "angles of the previous tick."
    ),
    "jacobi": (
        "Step all elements, and exchange all values between steps (Jacobi). The delay of one step from the computer to "
        "the drives is the tick of the experiment's bus (controller.bus_delay_ticks)."
    ),
}
COMPUTER_PART, BUS_PART, PLANT_PART = "computer", "bus", "plant"


def own_connectors(variables: Sequence[ExportedVariable]) -> tuple[ConnectorUnit, ...]:
    return tuple(
        (ssp.Connector(v.name, CAUSALITY_BY_KIND[v.kind], "Real", v.text, (), v.meaning), _unit(v)) for v in variables
    )


def own_values(
    experiment: Experiment, name: str, variables: Sequence[ExportedVariable], source: str, metadata: ssp.Metadata
) -> ssp.ParameterSet:
    """Return the parameter set of one of twin's own parts, archive entry `source`, with the origin of each value."""
    given = [v for v in variables if v.kind in ("parameter", "tunable")]
    values = [
        ssp.ParameterValue(v.name, "Real", v.start, v.text, origin(experiment, re.sub(r"\[\d+\]$", "", v.name)))
        for v in given
    ]
    units = unambiguous_units(_unit(v) for v in given)
    return ssp.ParameterSet(name, tuple(values), tuple(units.values()), source, metadata)


def _unit(variable: ExportedVariable) -> ssp.UnitDefinition:
    return ssp.UnitDefinition(variable.text, variable.unit.dimension, variable.unit.scale)


def system_readme(
    experiment: Experiment,
    members: Sequence[Member],
    connections: Sequence[ssp.Connection],
    hashes: Mapping[str, str],
    platforms: Sequence[Platform],
) -> str:
    cosim = experiment.cosim
    lines = [
        f"# {experiment.name}",
        "",
        f"{experiment.title}. A robot as a system of FMUs for co-simulation, SSP 1.0, written by twin.",
        "",
        "| element | FMU | values | |",
        "|---|---|---|---|",
        *(f"| `{m.name}` | `{m.entry}` | {f'`{m.values.source}`' if m.values else ''} | {m.about} |" for m in members),
        "",
        f"FMUs of twin's own are native code for {', '.join(p.name for p in platforms)}; drives are unchanged.",
        "",
        "## How to step it",
        "",
        f"Steps of {1e3 * cosim.tick:g} ms until {experiment.duration_ticks * cosim.tick:g} s. "
        f"{_SCHEME_TEXTS[cosim.scheme]}",
        "",
        "## Lines on connections",
        "",
        "A drive has its own zero, and may have its own units and gear: these connections have a LinearTransformation, "
        "factor * value + offset, and no other conversion. For a master without support for the offset, set the start "
        "value of the drive's angle to the robot's rest position; a last bit may then differ.",
        "",
        "| from | to | factor | offset |",
        "|---|---|---|---|",
        *(
            f"| `{'.'.join(c.start)}` | `{'.'.join(c.end)}` | {c.transformation.factor!r} | "
            f"{c.transformation.offset!r} |"
            for c in connections
            if c.transformation != ssp.IDENTITY_TRANSFORMATION
        ),
        "",
        "## Sources",
        "",
        "| file | SHA-256 |",
        "|---|---|",
        *(f"| `{entry}` | `{digest}` |" for entry, digest in hashes.items()),
        "",
    ]
    return "\n".join(lines)


def build_ssp(
    experiment: Path,
    fmi: str,
    platforms: Sequence[str],
    out: Path | None,
    drive: str | None,
    settings: Sequence[str],
    say: Callable[[str], None],
) -> Answer:
    """Write the robot of an experiment as an SSP archive: drives as delivered, computer and plant as twin's own FMUs.

    Options as in `twin build`. Arrays are scalars in all FMUs, as SSP 1.0 has no arrays.
    """
    targets = select_platforms(platforms, fmi)
    loaded = load_experiment(experiment, settings, drive)
    file = out or RESULTS_FOLDER / loaded.name / f"{loaded.name}.ssp"
    if out is not None:
        refuse_unwritable(file)
    _refuse_unexportable(loaded)
    # a Jacobi master already delays by the tick of the bus
    bus = [BUS_PART] if loaded.controller.bus_delay_ticks and loaded.cosim.scheme != "jacobi" else []
    parts = [part_of(loaded, name) for name in (COMPUTER_PART, *bus, PLANT_PART)]
    refuse_platform(file, targets)
    say("loading drives")
    drives = travelling_drives(loaded)
    makers = _ArchiveBuilder(loaded, fmi, targets, file, say)
    for part in parts[:-1]:
        makers.add_part(part)
    for number, joint in enumerate(drives, start=1):
        for element in joint.elements:
            makers.add_element(number, element)
    makers.add_part(parts[-1])
    content = makers.pack_archive(drives)
    if out is None:
        make_folder(file.parent)
    write_bytes(file, content)
    members = makers.members
    scheme = "Jacobi" if loaded.cosim.scheme == "jacobi" else "Gauss-Seidel"
    text = summary(f"{loaded.name}, SSP 1.0, {len(content) / 1000:.0f} KB", {
        "elements": ", ".join(member.name for member in members),
        "coupling": f"{scheme} in this order, steps of {1e3 * loaded.cosim.tick:g} ms",
        "until": f"{loaded.duration_ticks * loaded.cosim.tick:g} s",
        "FMUs": f"of ours FMI {fmi}, for {names_of(targets)}",
        "written": str(file),
    })  # fmt: skip
    return Answer(text, {
        "file": str(file),
        "experiment": loaded.name,
        "fmi": fmi,
        "platforms": [target.name for target in targets],
        "bytes": len(content),
        "scheme": loaded.cosim.scheme,
        "tick_s": loaded.cosim.tick,
        "stop_s": loaded.duration_ticks * loaded.cosim.tick,
        "components": {member.name: member.entry for member in members},
        "sha256": makers.hashes,
    })  # fmt: skip


def _refuse_unexportable(experiment: Experiment) -> None:
    """Refuse an experiment that an SSP cannot express, before anything is compiled or loaded."""
    for role, part in experiment.stand_ins.items():
        raise InputRefused(
            f"{experiment.name}: its {role} is {part.label}; it is third-party; only twin's own parts can be exported"
        )
    for found, table in ((experiment.faults, "fault"), (experiment.changes, "change")):
        if found:
            raise InputRefused(
                f"{experiment.name}: has [[{table}]] tables, which an SSP cannot express; build it "
                f"with --set {table}=[]"
            )
    cosim, bus = experiment.cosim, experiment.controller.bus_delay_ticks
    if cosim.iterations > 1:
        raise InputRefused(
            f"{experiment.name}: [cosim] iterations = {cosim.iterations}: masters of an SSP make each step once; build "
            "it with --set cosim.iterations=1"
        )
    if cosim.scheme == "jacobi" and bus != 1:
        raise InputRefused(
            f'{experiment.name}: [cosim] scheme = "jacobi" with controller.bus_delay_ticks = {bus}: a Jacobi '
            "master delays the computer's outputs by a tick, which is a bus of 1 tick; build it with "
            "--set controller.bus_delay_ticks=1, or --set cosim.scheme=gauss_seidel"
        )


class _ArchiveBuilder:
    """Builder of the files of an SSP archive with the robot's parts and drives."""

    def __init__(
        self, experiment: Experiment, fmi: str, platforms: Sequence[Platform], wanted: Path, say: Callable[[str], None]
    ):
        self._experiment, self._fmi, self._platforms, self._wanted, self._say = (
            experiment, fmi, platforms, wanted, say,
        )  # fmt: skip
        self._metadata = ssp.Metadata(description=experiment.title, tool=f"twin {version('twin')}")
        self._files: dict[str, bytes] = {}
        self._foreign: dict[str, str] = {}
        self.members: list[Member] = []

    @property
    def hashes(self) -> dict[str, str]:
        return {entry: hashlib.sha256(content).hexdigest() for entry, content in sorted(self._files.items())}

    def add_part(self, part: RobotPart) -> None:
        name, offered = part.name, open_parameters(part)
        layout = layout_of(part, offered)
        # SSP 1.0 has no arrays
        layout = replace(layout, variables=layout.scalars())
        description, closed = part_description(part), fixed_keys(part, offered)
        text = readme(part, layout, closed, self._platforms)
        entry = f"resources/{name}.fmu"

        def say(what: str) -> None:
            self._say(f"{name}: {what}")

        self._files[entry] = pack_fmu(part, layout, self._fmi, self._platforms, description, text, self._wanted, say)
        values = own_values(self._experiment, name, layout.variables, f"resources/{name}.ssv", self._metadata)
        self._add(Member(name, description, entry, own_connectors(layout.variables), values))

    def add_element(self, number: int, element: Element) -> None:
        if not isinstance(element.content, FmuDescription):
            component, at = element.content, self._experiment.start
            starts = zip(component.inputs, element.starts, strict=True)
            inputs = {port.name: (port, np.array([start])) for port, start in starts}
            self.add_part(RobotPart(element.name, self._experiment, (component,), {}, {}, inputs, at))
            return
        fmu = element.content
        by_name = {variable.name: variable for variable in (*element.variables, *(v for v, _ in element.settings))}
        table, source = _table(self._experiment, number, element.part), f"resources/{element.name}.ssv"
        values = foreign_values(self._experiment, element.name, table, fmu, element.settings, source, self._metadata)
        description = f"joint {number}: {fmu.model.description or fmu.model.modelName}"
        connectors = foreign_connectors(fmu, list(by_name.values()))
        self._add(Member(element.name, description, self._foreign_entry(fmu), connectors, values))

    def pack_archive(self, drives: Sequence[JointDrive]) -> bytes:
        experiment = self._experiment
        facts = {
            "name": experiment.name,
            "title": experiment.title,
            "values": without_folders(experiment.values),
            "origins": dict(sorted(experiment.origins.items())),
        }
        self._files["resources/experiment.json"] = (json_text(facts, indent=2) + "\n").encode()
        whole = structure(experiment, self.members, drives, self.hashes, self._metadata)
        text = system_readme(experiment, self.members, whole.system.connections, self.hashes, self._platforms)
        return zip_bytes(
            self._files | {ssp.STRUCTURE_FILE: structure_xml(whole), "documentation/README.md": text.encode()}
        )

    def _add(self, member: Member) -> None:
        if member.values is not None and not member.values.parameters:
            member = replace(member, values=None)
        if member.values is not None:
            self._files[member.values.source] = parameter_set_xml(member.values)
        self.members.append(member)

    def _foreign_entry(self, fmu: FmuDescription) -> str:
        """Return the archive path of a third-party FMU, which is stored once."""
        if fmu.sha256 not in self._foreign:
            stem = re.sub(r"[^A-Za-z0-9_.-]", "_", fmu.path.stem)
            # twin's own names are reserved
            taken = {*self._files, *(f"resources/{name}.fmu" for name in (COMPUTER_PART, BUS_PART, PLANT_PART))}
            entry, n = f"resources/{stem}.fmu", 1
            while entry in taken:
                n += 1
                entry = f"resources/{stem}_{n}.fmu"
            self._foreign[fmu.sha256] = entry
            self._files[entry] = fmu.path.read_bytes()
        return self._foreign[fmu.sha256]


def _table(experiment: Experiment, number: int, part: str) -> str:
    """Return the name of the experiment's table that sets the parameters of a drive's FMU."""
    tail = f"parts.{part}.parameters" if part else "parameters"
    own = f"drive.joint_{number}.{tail}"
    return own if any(key.startswith(own) for key in experiment.origins) else f"drive.{tail}"
