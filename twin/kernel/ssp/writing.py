"""The writer of SSP 1.0 structures (SSD) and parameter files (SSV)."""

import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from twin.kernel.ssp.parameters import (
    METADATA,
    NONE,
    PARAMETER_MAPPING,
    PARAMETER_SET,
    WHOLES,
    Annotation,
    Metadata,
    ParameterBinding,
    ParameterMapping,
    ParameterSet,
    ParameterValue,
    Transformation,
    UnitDefinition,
)
from twin.kernel.ssp.structure import FMU, TRUTH, Connection, Connector, SspComponent, SspSystem, Structure

VERSION = "1.0"
Item = TypeVar("Item")
SSC, SSD, SSV, SSM = (
    f"{{http://ssp-standard.org/SSP1/SystemStructure{name}}}"
    for name in ("Common", "Description", "ParameterValues", "ParameterMapping")
)
for prefix, namespace in (("ssc", SSC), ("ssd", SSD), ("ssv", SSV), ("ssm", SSM)):
    ET.register_namespace(prefix, namespace[1:-1])


def structure_xml(structure: Structure) -> bytes:
    """SystemStructure.ssd, UTF-8. Parameter sets and mappings with a source are referred to, the others are inside."""
    root = ET.Element(f"{SSD}SystemStructureDescription", {"version": VERSION, "name": structure.name})
    root.attrib.update(_metadata(structure.metadata))
    _append_system(root, structure.system)
    if structure.enumerations:
        listed = ET.SubElement(root, f"{SSD}Enumerations")
        for name, items in structure.enumerations:
            enumeration = ET.SubElement(listed, f"{SSC}Enumeration", name=name)
            for item, value in items:
                ET.SubElement(enumeration, f"{SSC}Item", name=item, value=str(value))
    _append_units(root, SSD, structure.units)
    experiment = structure.experiment
    times = {"startTime": experiment.start, "stopTime": experiment.stop}
    stated = {name: repr(float(time)) for name, time in times.items() if time is not None}
    if stated or experiment.annotations:
        _append_annotations(ET.SubElement(root, f"{SSD}DefaultExperiment", stated), SSD, experiment.annotations)
    _append_annotations(root, SSD, structure.annotations)
    return _bytes(root)


def parameter_set_xml(values: ParameterSet) -> bytes:
    """The SSV file of a set, UTF-8."""
    return _bytes(_parameter_set(values))


def _bytes(root: ET.Element) -> bytes:
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


def _metadata(metadata: Metadata) -> dict[str, str]:
    return {name: text for name, text in zip(METADATA, vars(metadata).values(), strict=True) if text}


def _append_annotations(parent: ET.Element, namespace: str, annotations: Sequence[Annotation]) -> None:
    if annotations:
        listed = ET.SubElement(parent, f"{namespace}Annotations")
        for annotation in annotations:
            one = ET.SubElement(listed, f"{SSC}Annotation", type=annotation.type)
            if annotation.content:
                one.append(ET.fromstring(annotation.content))


def _append_units(parent: ET.Element, namespace: str, units: Sequence[UnitDefinition]) -> None:
    if units:
        listed = ET.SubElement(parent, f"{namespace}Units")
        for unit in units:
            powers = {name: str(power) for name, power in unit.dimension._asdict().items() if power}
            factor = {"factor": repr(unit.factor)} if unit.factor != 1.0 else {}
            offset = {"offset": repr(unit.offset)} if unit.offset else {}
            one = ET.SubElement(listed, f"{SSC}Unit", name=unit.name)
            ET.SubElement(one, f"{SSC}BaseUnit", powers | factor | offset)


def _append_component(parent: ET.Element, element: SspComponent) -> None:
    stated = {"name": element.name, **_described(element.description), "source": element.source}
    stated |= {"type": element.type} if element.type != FMU else {}
    stated |= {"implementation": element.implementation} if element.implementation != "any" else {}
    component = ET.SubElement(parent, f"{SSD}Component", stated)
    _append_interface(component, element)
    _append_annotations(component, SSD, element.annotations)


def _append_system(parent: ET.Element, system: SspSystem) -> None:
    one = ET.SubElement(parent, f"{SSD}System", {"name": system.name, **_described(system.description)})
    _append_interface(one, system)
    elements = ET.SubElement(one, f"{SSD}Elements")
    for element in system.elements:
        if isinstance(element, SspSystem):
            _append_system(elements, element)
        else:
            _append_component(elements, element)
    _append_all(one, "Connections", system.connections, _append_connection)
    _append_annotations(one, SSD, system.annotations)


def _append_interface(parent: ET.Element, element: SspComponent | SspSystem) -> None:
    _append_all(parent, "Connectors", element.connectors, _append_connector)
    _append_all(parent, "ParameterBindings", element.bindings, _append_binding)


def _append_all(
    parent: ET.Element, tag: str, items: Sequence[Item], append: Callable[[ET.Element, Item], None]
) -> None:
    """What stands in an element of its own, which the schema does not allow to be empty."""
    if items:
        inside = ET.SubElement(parent, f"{SSD}{tag}")
        for item in items:
            append(inside, item)


def _append_connector(parent: ET.Element, connector: Connector) -> None:
    stated = {"name": connector.name, "kind": connector.kind, **_described(connector.description)}
    one = ET.SubElement(parent, f"{SSD}Connector", stated)
    if connector.type:
        ET.SubElement(one, f"{SSC}{connector.type}", {"unit": connector.unit} if connector.unit else {})


def _append_connection(parent: ET.Element, connection: Connection) -> None:
    stated = {
        f"{side}{what}": text
        for side, end in (("start", connection.start), ("end", connection.end))
        for what, text in zip(("Element", "Connector"), end, strict=True)
        if text
    }
    stated |= {"suppressUnitConversion": "true"} if connection.suppress_unit_conversion else {}
    _append_transformation(ET.SubElement(parent, f"{SSD}Connection", stated), connection.transformation)


def _append_transformation(parent: ET.Element, transformation: Transformation) -> None:
    if transformation != NONE:
        factor, offset = repr(transformation.factor), repr(transformation.offset)
        ET.SubElement(parent, f"{SSC}LinearTransformation", factor=factor, offset=offset)


def _append_binding(parent: ET.Element, binding: ParameterBinding) -> None:
    values, to = binding.parameters, binding.mapping
    one = ET.SubElement(parent, f"{SSD}ParameterBinding", {"prefix": binding.prefix} if binding.prefix else {})
    if values.source:
        one.attrib.update(type=PARAMETER_SET, source=values.source)
    else:
        ET.SubElement(one, f"{SSD}ParameterValues").append(_parameter_set(values))
    if to is not None:
        led = ET.SubElement(one, f"{SSD}ParameterMapping")
        if to.source:
            led.attrib.update(type=PARAMETER_MAPPING, source=to.source)
        else:
            led.append(_parameter_mapping(to))


def _parameter_set(values: ParameterSet) -> ET.Element:
    root = ET.Element(f"{SSV}ParameterSet", {"version": VERSION, "name": values.name, **_metadata(values.metadata)})
    listed = ET.SubElement(root, f"{SSV}Parameters")
    for value in values.parameters:
        one = ET.SubElement(listed, f"{SSV}Parameter", {"name": value.name, **_described(value.description)})
        stated = {"value": _text(value)} | ({"unit": value.unit} if value.unit else {})
        ET.SubElement(one, f"{SSV}{value.type}", stated)
    _append_units(root, SSV, values.units)
    _append_annotations(root, SSV, values.annotations)
    return root


def _text(value: ParameterValue) -> str:
    """A value as the file has it."""
    (one,) = value.values
    if isinstance(one, str):
        return one
    if value.type == "Boolean":
        return next(text for text, truth in TRUTH.items() if truth == bool(one))
    return str(round(one)) if value.type in WHOLES else repr(float(one))


def _parameter_mapping(to: ParameterMapping) -> ET.Element:
    root = ET.Element(f"{SSM}ParameterMapping", {"version": VERSION, **_metadata(to.metadata)})
    for entry in to.entries:
        stated = {"source": entry.source, "target": entry.target}
        stated |= {"suppressUnitConversion": "true"} if entry.suppress_unit_conversion else {}
        _append_transformation(ET.SubElement(root, f"{SSM}MappingEntry", stated), entry.transformation)
    return root


def _described(text: str) -> Mapping[str, str]:
    return {"description": text} if text else {}
