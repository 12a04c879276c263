"""Writer of a system as an SSP 1.0 archive, for systems that `twin cosim` has read from any format."""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from dataclasses import replace

from twin.kernel.archive import read_entry, zip_bytes
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.variable import Variable
from twin.kernel.ssp import structure as ssp
from twin.kernel.ssp.package import MAX_FMU_SIZE, SCHEME_ANNOTATION
from twin.kernel.ssp.ssd import structure_xml
from twin.kernel.systems.plan import IMPLEMENTATION_KINDS, SystemPlan
from twin.kernel.systems.timing import ORDER_ANNOTATION, step_notes

STEP_ANNOTATION = "twin.step"
IMPLEMENTATION_NAMES = {kind: name for name, kind in IMPLEMENTATION_KINDS.items() if kind}


def ssp_archive(plan: SystemPlan) -> bytes:
    """Write a system as an SSP archive: planned structure, FMUs, tables and parameter sets.

    The user's values, steps, times, kinds and step order are included. SSP does not define step size, step order and
    coupling scheme; these are annotations, which `twin cosim` reads.
    """
    package = plan.package
    fed = [feed for feed in plan.extras.feeds if feed.by.startswith("--input")]
    if fed:
        raise InputRefused(f"{fed[0].by}: an SSP archive has no word for it; put a table (CSV) into the archive")
    parts = {part.path: part for part in plan.parts}
    root = package.structure.system
    values = [
        ssp.ParameterBinding(
            ssp.ParameterSet("set", tuple(_value(f"{path}.{v.name}", v, value) for v, value in part.settings))
        )
        for path, part in parts.items()
        if part.settings
    ]
    connectors = _connectors(plan)
    kinds = {path: IMPLEMENTATION_NAMES[part.description.kind] for path, part in parts.items()}
    timing = plan.timing
    steps = {path: count * timing.tick for path, count in timing.periods.items() if count > 1}
    order = ET.Element("order")
    for part in plan.parts:
        ET.SubElement(order, "component", name=part.path)
    system = replace(
        _complete_components(root, "", connectors, kinds, steps),
        bindings=(*root.bindings, *values),
        annotations=(
            *_foreign_annotations(root.annotations),
            *step_notes(STEP_ANNOTATION, timing.tick),
            ssp.Annotation(SCHEME_ANNOTATION, f'<scheme name="{plan.scheme}" />'),
            ssp.Annotation(ORDER_ANNOTATION, ET.tostring(order, encoding="unicode")),
        ),
    )
    experiment = ssp.DefaultExperiment(timing.first * timing.tick, timing.ticks * timing.tick)
    whole = ssp.Structure(
        package.structure.name or system.name,
        system,
        units=package.structure.units,
        enumerations=package.structure.enumerations,
        experiment=experiment,
        metadata=package.structure.metadata,
    )
    entries = {ssp.STRUCTURE_FILE: structure_xml(whole)}
    for entry in package.entries:
        if entry != ssp.STRUCTURE_FILE and not entry.endswith("/"):
            entries[entry] = package.content(entry) if package.loose else read_entry(package.file, entry, MAX_FMU_SIZE)
    return zip_bytes(entries)


def _foreign_annotations(annotations: Iterable[ssp.Annotation]) -> tuple[ssp.Annotation, ...]:
    """Drop SSP annotations that are written again, and step annotations of other tools."""
    return tuple(
        one
        for one in annotations
        if one.type not in (STEP_ANNOTATION, ORDER_ANNOTATION, SCHEME_ANNOTATION) and "tepSize" not in one.content
    )


def _value(name: str, variable: Variable, value: object) -> ssp.ParameterValue:
    if isinstance(value, list):
        if len(value) != 1 or not isinstance(value[0], str):
            raise InputRefused(f"{name}: arrays of text and bytes cannot be written as SSP 1.0")
        return ssp.ParameterValue(name, "String", (value[0],))
    if not isinstance(value, float | int):
        raise InputRefused(f"{name}: an array, which SSP 1.0 does not have")
    return ssp.ParameterValue(name, _type(variable), (float(value),))


def _type(variable: Variable) -> str:
    return "Integer" if variable.type == "Enumeration" else _ssp_1_type(variable.type)


def _connectors(plan: SystemPlan) -> dict[str, list[ssp.Connector]]:
    found: dict[str, list[ssp.Connector]] = {}
    for part in plan.parts:
        ports = [port.variable for port in (*part.inputs, *part.outputs)]
        for variable in dict.fromkeys(ports):
            if variable.dimensions:
                raise InputRefused(f"{part.path}.{variable.name}: an array, which SSP 1.0 does not have")
            kind: ssp.ConnectorKind = "input" if variable.causality == "input" else "output"
            if variable.causality in ("input", "output", "local"):
                found.setdefault(part.path, []).append(ssp.Connector(variable.name, kind, _type(variable)))
    return found


def _complete_components(
    system: ssp.SspSystem,
    path: str,
    connectors: Mapping[str, list[ssp.Connector]],
    kinds: Mapping[str, ssp.Implementation],
    steps: Mapping[str, float],
) -> ssp.SspSystem:
    elements: list[ssp.SspComponent | ssp.SspSystem] = []
    for one in system.elements:
        below = f"{path}.{one.name}" if path else one.name
        if isinstance(one, ssp.SspSystem):
            elements.append(_complete_components(one, below, connectors, kinds, steps))
            continue
        more = [new for new in connectors.get(below, ()) if new.name not in one.connector_of]
        old = tuple(replace(c, type=_ssp_1_type(c.type)) for c in one.connectors)
        notes = _foreign_annotations(one.annotations)
        if below in steps:
            notes = (*notes, *step_notes(STEP_ANNOTATION, steps[below]))
        elements.append(
            replace(
                one, connectors=(*old, *more), implementation=kinds.get(below, one.implementation), annotations=notes
            )
        )
    return replace(system, elements=tuple(elements))


def _ssp_1_type(type_: str) -> str:
    return "Real" if type_ in ssp.REAL_TYPES else "Integer" if type_ in ssp.INTEGER_TYPES else type_
