"""Reader and writer of SystemStructure.ssd, parameter sets (SSV) and mappings (SSM).

Reads SSP 1.0 and 2.0, writes 1.0. https://ssp-standard.org/docs/2.0
"""

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple, TypeVar, cast, get_args

from twin.kernel.errors import InputRefused
from twin.kernel.files import parse_xml
from twin.kernel.ssp import structure as ssp
from twin.kernel.ssp.structure import boolean_attribute, child_elements, grouped_children
from twin.kernel.units import has_plain_digits

MAX_PARAMETERS = 100_000
"""Maximum number of parameters of a set, and of entries of a mapping."""
TEXT_TYPES = ("String", "Enumeration", "Binary")
MAX_PARTS = 10_000
"""Maximum number of components and systems; a larger file would take minutes."""
Item = TypeVar("Item")
VERSION = "1.0"
SSC, SSD, SSV, SSM = (
    f"{{http://ssp-standard.org/SSP1/SystemStructure{name}}}"
    for name in ("Common", "Description", "ParameterValues", "ParameterMapping")
)
for prefix, namespace in (("ssc", SSC), ("ssd", SSD), ("ssv", SSV), ("ssm", SSM)):
    ET.register_namespace(prefix, namespace[1:-1])


def parameter_set(content: bytes, where: str, source: str = "") -> ssp.ParameterSet:
    """Read an SSP parameter set from the content of an SSV file, `source` in the archive."""
    return parameter_set_of(parse_xml(content, where), where, source)


def parameter_set_of(root: ET.Element, where: str, source: str = "") -> ssp.ParameterSet:
    if ssp.local_name(root) != "ParameterSet":
        raise InputRefused(f"{where}: <{ssp.local_name(root)}>; expected <ParameterSet>, an SSV file")
    found = grouped_children(root, "Parameters", "Parameter")
    if len(found) > MAX_PARAMETERS:
        raise InputRefused(f"{where}: {len(found)} parameters; expected at most {MAX_PARAMETERS}")
    values: dict[str, ssp.ParameterValue] = {}
    for element in found:
        name = element.get("name", "")
        unread = ("Annotations", "Dimension", "MetaData", "Signature")
        kinds = [child for child in element if ssp.local_name(child) not in unread]
        if not name or name in values or len(kinds) != 1:
            wrong = "without a name" if not name else "given twice" if name in values else "without one value"
            raise InputRefused(f"{where}: a parameter {wrong}{f', {name}' if name else ''}")
        type_ = ssp.local_name(kinds[0])
        taken = values_of(kinds[0], type_, f"{where}: {name}")
        values[name] = ssp.ParameterValue(name, type_, taken, kinds[0].get("unit", ""), element.get("description", ""))
    units = ssp.units_of(root, where)
    return ssp.ParameterSet(
        root.get("name", ""), tuple(values.values()), units, source, ssp.metadata_of(root), ssp.annotations_of(root)
    )


def mapping_of(root: ET.Element, where: str, source: str = "") -> ssp.ParameterMapping:
    if ssp.local_name(root) != "ParameterMapping":
        raise InputRefused(f"{where}: <{ssp.local_name(root)}>; expected <ParameterMapping>, an SSM file")
    found = child_elements(root, "MappingEntry")
    if len(found) > MAX_PARAMETERS:
        raise InputRefused(f"{where}: {len(found)} entries; expected at most {MAX_PARAMETERS}")
    entries = [
        ssp.MappingEntry(
            ssp.required_attribute(entry, "source", where),
            ssp.required_attribute(entry, "target", where),
            ssp.transformation_of(entry, where),
            boolean_attribute(entry, "suppressUnitConversion", where),
        )
        for entry in found
        # tools write entries with an empty source for users to fill in
        if entry.get("source") != ""
    ]
    return ssp.ParameterMapping(tuple(entries), source, ssp.metadata_of(root))


def values_of(element: ET.Element, type_: str, where: str) -> tuple[float, ...] | tuple[str, ...]:
    """Return the values of a typed XML element such as <Real value="1.5"/>."""
    text = element.get("value")
    if type_ in TEXT_TYPES:
        # an array of text has a <Value> element for each item
        return tuple(one.get("value", "") for one in child_elements(element, "Value")) if text is None else (text,)
    words = re.split(r"\s+", (text or "").strip())
    return tuple(_number(word, type_, where) for word in words)


def _number(text: str, type_: str, where: str) -> float:
    try:
        if type_ == "Boolean":
            return float(ssp.BOOLEAN_VALUES[text])
        if not has_plain_digits(text):
            raise ValueError
        value = float(int(text)) if type_ in ssp.INTEGER_TYPES else float(text) if type_ in ssp.REAL_TYPES else math.nan
        if type_ in ssp.INTEGER_TYPES and value != int(text):
            # exact: a double would round it, and the target variable may refuse the rounded value
            return int(text)
    except (KeyError, ValueError, OverflowError):
        value = math.nan
    if not math.isfinite(value):
        raise InputRefused(f"{where}: {type_} '{text[:40]}'; expected finite numbers, truth values or text")
    return value


class Resource(NamedTuple):
    """A file of an SSP archive: content, entry name, and prefix of error messages."""

    content: bytes
    entry: str
    where: str


ResourceLoader = Callable[[str, str], Resource]
"""Function that loads the resource of a URI; the second argument names the referring element for messages."""


def structure_of(content: bytes, where: str, load: ResourceLoader) -> ssp.Structure:
    """Parse the content of an SSP's SystemStructure.ssd; `load` loads parameter sets and mappings in other files."""
    root = parse_xml(content, where)
    if root.tag != f"{SSD}SystemStructureDescription":
        raise InputRefused(
            f"{where}: <{ssp.local_name(root)}>; expected <SystemStructureDescription> of SSP 1.0 or 2.0, namespace "
            f"{SSD[1:-1]}"
        )
    version = root.get("version", "")
    if not re.match(r"[12]\.[0-9]", version):
        raise InputRefused(f"{where}: version '{version}'; expected 1.0 or 2.0")
    system = next(iter(child_elements(root, "System")), None)
    if system is None:
        raise InputRefused(f"{where}: has no system")
    enumerations = tuple(
        (
            ssp.required_attribute(one, "name", where),
            tuple(
                (ssp.required_attribute(i, "name", where), int(ssp.number_attribute(i, "value", where, 0)))
                for i in child_elements(one, "Item")
            ),
        )
        for one in grouped_children(root, "Enumerations", "Enumeration")
    )
    experiment = ssp.DefaultExperiment()
    for stated in child_elements(root, "DefaultExperiment")[:1]:
        start, stop = (ssp.number_attribute(stated, time, where, None) for time in ("startTime", "stopTime"))
        experiment = ssp.DefaultExperiment(start, stop, ssp.annotations_of(stated))
    return ssp.Structure(
        name=root.get("name", ""),
        system=_SystemReader(where, load).system(system, "system"),
        version=version,
        units=ssp.units_of(root, where),
        enumerations=enumerations,
        experiment=experiment,
        metadata=ssp.metadata_of(root),
        annotations=ssp.annotations_of(root),
    )


class _SystemReader:
    """Reader of an SSD's systems and their nested elements."""

    def __init__(self, where: str, load: ResourceLoader):
        self._where, self._load = where, load
        self._parts = 0
        self._budget = ssp.ParseBudget(where)
        self._known: dict[tuple[str, str], object] = {}

    def system(self, element: ET.Element, place: str) -> ssp.SspSystem:
        name = ssp.required_attribute(element, "name", self._where)
        for unread in ("SignalDictionaries", "SignalDictionary"):
            if child_elements(element, unread):
                raise InputRefused(f"{self._where}: {place} '{name}' has signal dictionaries, which are not supported")
        parts = [self._part(part) for group in child_elements(element, "Elements") for part in group]
        ssp.require_unique((part.name for part in parts), f"elements of {place} '{name}'", self._where)
        connections = [self._connection(one) for one in grouped_children(element, "Connections", "Connection")]
        return ssp.SspSystem(
            name=name,
            elements=tuple(parts),
            connections=tuple(connections),
            connectors=self._connectors(element, name),
            bindings=self._bindings(element, name),
            description=element.get("description", ""),
            annotations=ssp.annotations_of(element),
        )

    def _part(self, element: ET.Element) -> ssp.SspComponent | ssp.SspSystem:
        self._parts += 1
        if self._parts > MAX_PARTS:
            raise InputRefused(f"{self._where}: more than {MAX_PARTS} parts; do not trust this file")
        if ssp.local_name(element) == "System":
            return self.system(element, "the system")
        name = ssp.required_attribute(element, "name", self._where)
        if ssp.local_name(element) != "Component":
            kind = re.sub(r"(?<!^)([A-Z])", r" \1", ssp.local_name(element)).lower()
            raise InputRefused(f"{self._where}: element '{name}' is a {kind}, which is not supported")
        implementation = element.get("implementation", "any")
        if implementation not in get_args(ssp.Implementation):
            known = ", ".join(get_args(ssp.Implementation))
            raise InputRefused(f"{self._where}: '{name}': implementation '{implementation}'; expected {known}")
        return ssp.SspComponent(
            name=name,
            source=element.get("source", ""),
            type=element.get("type", ssp.FMU_TYPE),
            implementation=cast(ssp.Implementation, implementation),
            connectors=self._connectors(element, name),
            bindings=self._bindings(element, name),
            description=element.get("description", ""),
            annotations=ssp.annotations_of(element),
        )

    def _connectors(self, element: ET.Element, owner: str) -> tuple[ssp.Connector, ...]:
        found = [self._connector(one, owner) for one in grouped_children(element, "Connectors", "Connector")]
        ssp.require_unique((one.name for one in found), f"connectors of '{owner}'", self._where)
        return tuple(found)

    def _connector(self, element: ET.Element, owner: str) -> ssp.Connector:
        self._budget.spend()
        name, kind = (ssp.required_attribute(element, key, self._where) for key in ("name", "kind"))
        if kind not in get_args(ssp.ConnectorKind):
            known = ", ".join(get_args(ssp.ConnectorKind))
            raise InputRefused(f"{self._where}: {owner}.{name}: kind '{kind}'; expected {known}")
        unread = ("ConnectorGeometry", "Annotations", "Dimension", "Clock")
        stated = next((child for child in element if ssp.local_name(child) not in unread), None)
        sizes = [(one.get("size"), one.get("sizeConnector", "")) for one in child_elements(element, "Dimension")]
        if not all((size or "1").isdecimal() and (size or by) for size, by in sizes):
            raise InputRefused(f"{self._where}: {owner}.{name}: a dimension without a size")
        return ssp.Connector(
            name=name,
            kind=cast(ssp.ConnectorKind, kind),
            type="" if stated is None else ssp.local_name(stated),
            unit="" if stated is None else stated.get("unit", ""),
            dimensions=tuple(by if size is None else int(size) for size, by in sizes),
            description=element.get("description", ""),
        )

    def _connection(self, element: ET.Element) -> ssp.Connection:
        self._budget.spend()
        start, end = (
            ssp.Endpoint(
                element.get(f"{side}Element", ""), ssp.required_attribute(element, f"{side}Connector", self._where)
            )
            for side in ("start", "end")
        )
        if element.get("startIndices") or element.get("endIndices"):
            raise InputRefused(
                f"{self._where}: the connection from {'.'.join(start)} to {'.'.join(end)} selects elements of arrays "
                "(startIndices, endIndices), which is not supported; connect whole arrays"
            )
        suppressed = boolean_attribute(element, "suppressUnitConversion", self._where)
        return ssp.Connection(start, end, ssp.transformation_of(element, self._where), suppressed)

    def _bindings(self, element: ET.Element, owner: str) -> tuple[ssp.ParameterBinding, ...]:
        return tuple(
            self._binding(one, f"parameters of '{owner}'")
            for one in grouped_children(element, "ParameterBindings", "ParameterBinding")
        )

    def _binding(self, element: ET.Element, what: str) -> ssp.ParameterBinding:
        self._budget.spend()
        inline = next(iter(child_elements(element, "ParameterValues")), None)
        values = self._read_resource(element, inline, ssp.PARAMETER_SET, what, parameter_set_of)
        if values is None:
            raise InputRefused(f"{self._where}: {what}: neither a source nor values")
        led = next(iter(child_elements(element, "ParameterMapping")), None)
        to = None if led is None else self._read_resource(led, led, ssp.PARAMETER_MAPPING, what, mapping_of)
        return ssp.ParameterBinding(values, element.get("prefix", ""), to)

    def _read_resource(
        self,
        element: ET.Element,
        inline: ET.Element | None,
        type_: str,
        what: str,
        of_element: Callable[[ET.Element, str, str], Item],
    ) -> Item | None:
        """Read a parameter set or mapping from its file, or from the element `inline`; None if there is neither."""
        if element.get("type", type_) != type_:
            raise InputRefused(f"{self._where}: {what} are of type '{element.get('type')}'; expected {type_}")
        if source := element.get("source", ""):
            if element.get("sourceBase", "SSD") != "SSD":
                raise InputRefused(
                    f"{self._where}: {what}: {source} lies in the component itself (sourceBase), which is "
                    "not read here; put it into the archive"
                )
            # several components may refer to the same file
            if (type_, source) not in self._known:
                content, entry, where = self._load(source, what)
                self._known[type_, source] = of_element(parse_xml(content, where), where, entry)
            return cast(Item, self._known[type_, source])
        stated = [one for name in ("ParameterSet", "ParameterMapping") for one in child_elements(inline, name)]
        return of_element(stated[0], f"{self._where}: {what}", "") if stated else None


def structure_xml(structure: ssp.Structure) -> bytes:
    """Write an SSP structure as SystemStructure.ssd (UTF-8); sets with a source are referenced, others inlined."""
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


def parameter_set_xml(values: ssp.ParameterSet) -> bytes:
    """Write an SSP parameter set as the content of an SSV file (UTF-8)."""
    return _bytes(_parameter_set(values))


def _bytes(root: ET.Element) -> bytes:
    ET.indent(root)
    return ET.tostring(root, encoding="UTF-8", xml_declaration=True) + b"\n"


def _metadata(metadata: ssp.Metadata) -> dict[str, str]:
    return {name: text for name, text in zip(ssp.METADATA_ATTRIBUTES, vars(metadata).values(), strict=True) if text}


def _append_annotations(parent: ET.Element, namespace: str, annotations: Sequence[ssp.Annotation]) -> None:
    if annotations:
        listed = ET.SubElement(parent, f"{namespace}Annotations")
        for annotation in annotations:
            one = ET.SubElement(listed, f"{SSC}Annotation", type=annotation.type)
            if annotation.content:
                one.append(ET.fromstring(annotation.content))


def _append_units(parent: ET.Element, namespace: str, units: Sequence[ssp.UnitDefinition]) -> None:
    if units:
        listed = ET.SubElement(parent, f"{namespace}Units")
        for unit in units:
            powers = {name: str(power) for name, power in unit.dimension._asdict().items() if power}
            factor = {"factor": repr(unit.factor)} if unit.factor != 1.0 else {}
            offset = {"offset": repr(unit.offset)} if unit.offset else {}
            one = ET.SubElement(listed, f"{SSC}Unit", name=unit.name)
            ET.SubElement(one, f"{SSC}BaseUnit", powers | factor | offset)


def _append_component(parent: ET.Element, element: ssp.SspComponent) -> None:
    stated = {"name": element.name, **_description_attribute(element.description), "source": element.source}
    stated |= {"type": element.type} if element.type != ssp.FMU_TYPE else {}
    stated |= {"implementation": element.implementation} if element.implementation != "any" else {}
    component = ET.SubElement(parent, f"{SSD}Component", stated)
    _append_interface(component, element)
    _append_annotations(component, SSD, element.annotations)


def _append_system(parent: ET.Element, system: ssp.SspSystem) -> None:
    one = ET.SubElement(parent, f"{SSD}System", {"name": system.name, **_description_attribute(system.description)})
    _append_interface(one, system)
    elements = ET.SubElement(one, f"{SSD}Elements")
    for element in system.elements:
        if isinstance(element, ssp.SspSystem):
            _append_system(elements, element)
        else:
            _append_component(elements, element)
    _append_all(one, "Connections", system.connections, _append_connection)
    _append_annotations(one, SSD, system.annotations)


def _append_interface(parent: ET.Element, element: ssp.SspComponent | ssp.SspSystem) -> None:
    _append_all(parent, "Connectors", element.connectors, _append_connector)
    _append_all(parent, "ParameterBindings", element.bindings, _append_binding)


def _append_all(
    parent: ET.Element, tag: str, items: Sequence[Item], append: Callable[[ET.Element, Item], None]
) -> None:
    """Append `items` in an enclosing XML element; omitted if there are no items, as the schema forbids empty lists."""
    if items:
        inside = ET.SubElement(parent, f"{SSD}{tag}")
        for item in items:
            append(inside, item)


def _append_connector(parent: ET.Element, connector: ssp.Connector) -> None:
    stated = {"name": connector.name, "kind": connector.kind, **_description_attribute(connector.description)}
    one = ET.SubElement(parent, f"{SSD}Connector", stated)
    if connector.type:
        ET.SubElement(one, f"{SSC}{connector.type}", {"unit": connector.unit} if connector.unit else {})


def _append_connection(parent: ET.Element, connection: ssp.Connection) -> None:
    stated = {
        f"{side}{what}": text
        for side, end in (("start", connection.start), ("end", connection.end))
        for what, text in zip(("Element", "Connector"), end, strict=True)
        if text
    }
    stated |= {"suppressUnitConversion": "true"} if connection.suppress_unit_conversion else {}
    _append_transformation(ET.SubElement(parent, f"{SSD}Connection", stated), connection.transformation)


def _append_transformation(parent: ET.Element, transformation: ssp.Transformation) -> None:
    if transformation != ssp.IDENTITY_TRANSFORMATION:
        factor, offset = repr(transformation.factor), repr(transformation.offset)
        ET.SubElement(parent, f"{SSC}LinearTransformation", factor=factor, offset=offset)


def _append_binding(parent: ET.Element, binding: ssp.ParameterBinding) -> None:
    values, to = binding.parameters, binding.mapping
    one = ET.SubElement(parent, f"{SSD}ParameterBinding", {"prefix": binding.prefix} if binding.prefix else {})
    if values.source:
        one.attrib.update(type=ssp.PARAMETER_SET, source=values.source)
    else:
        ET.SubElement(one, f"{SSD}ParameterValues").append(_parameter_set(values))
    if to is not None:
        led = ET.SubElement(one, f"{SSD}ParameterMapping")
        if to.source:
            led.attrib.update(type=ssp.PARAMETER_MAPPING, source=to.source)
        else:
            led.append(_parameter_mapping(to))


def _parameter_set(values: ssp.ParameterSet) -> ET.Element:
    root = ET.Element(f"{SSV}ParameterSet", {"version": VERSION, "name": values.name, **_metadata(values.metadata)})
    listed = ET.SubElement(root, f"{SSV}Parameters")
    for value in values.parameters:
        one = ET.SubElement(
            listed, f"{SSV}Parameter", {"name": value.name, **_description_attribute(value.description)}
        )
        stated = {"value": _text(value)} | ({"unit": value.unit} if value.unit else {})
        ET.SubElement(one, f"{SSV}{value.type}", stated)
    _append_units(root, SSV, values.units)
    _append_annotations(root, SSV, values.annotations)
    return root


def _text(value: ssp.ParameterValue) -> str:
    (one,) = value.values
    if isinstance(one, str):
        return one
    if value.type == "Boolean":
        return next(text for text, truth in ssp.BOOLEAN_VALUES.items() if truth == bool(one))
    return str(round(one)) if value.type in ssp.INTEGER_TYPES else repr(float(one))


def _parameter_mapping(to: ssp.ParameterMapping) -> ET.Element:
    root = ET.Element(f"{SSM}ParameterMapping", {"version": VERSION, **_metadata(to.metadata)})
    for entry in to.entries:
        stated = {"source": entry.source, "target": entry.target}
        stated |= {"suppressUnitConversion": "true"} if entry.suppress_unit_conversion else {}
        _append_transformation(ET.SubElement(root, f"{SSM}MappingEntry", stated), entry.transformation)
    return root


def _description_attribute(text: str) -> Mapping[str, str]:
    return {"description": text} if text else {}
