"""Data classes of an SSP system: components, connectors, connections, parameter sets and mappings (SSD, SSV, SSM).

Includes readers of the XML elements that these files share (SSC). Elements are found by local name, without namespace,
as each name has one meaning. Units and linear transformations: SSP 1.0, 4.5.3 and 4.5.4.
"""

import math
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple, TypeVar

from twin.kernel.errors import InputRefused
from twin.kernel.units import Dimension, parse_float

METADATA_ATTRIBUTES = (
    "description",
    "author",
    "fileversion",
    "copyright",
    "license",
    "generationTool",
    "generationDateAndTime",
)
"""XML attributes of the fields of `Metadata`, in their order."""
PARAMETER_SET = "application/x-ssp-parameter-set"
PARAMETER_MAPPING = "application/x-ssp-parameter-mapping"
REAL_TYPES = ("Real", "Float64", "Float32")
INTEGER_TYPES = ("Integer", *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)))
"""Numeric types: the first of SSP 1.0, the others of 2.0."""
BOOLEAN_VALUES = {"true": True, "1": True, "false": False, "0": False}
MAX_POWER = 100
"""Maximum power of a base unit; real units need 4."""
MAX_PARSE_TIME = 30.0
"""Maximum processor time to read a structure, and again to flatten it (s). The largest permitted file takes a tenth."""
STRUCTURE_FILE = "SystemStructure.ssd"
FMU_TYPE = "application/x-fmu-sharedlibrary"
TABLE_TYPE = "application/table"
"""MIME type of OMSimulator components that are tables of values over time."""
ConnectorKind = Literal[
    "input", "output", "inout", "parameter", "calculatedParameter", "structuralParameter", "constant", "local"
]
"""Kinds of connectors in SSP; the last three are of SSP 2.0."""
Implementation = Literal["any", "CoSimulation", "ModelExchange", "ScheduledExecution"]
Default = TypeVar("Default")


@dataclass(frozen=True)
class Annotation:
    """A tool's annotation of an SSP element: reverse domain name, "org.openmodelica", and XML content, "" if empty."""

    type: str
    content: str = ""


@dataclass(frozen=True)
class Metadata:
    """Metadata of an SSP file (SSP 1.0, 4.4.2); "" if not stated. `generated` is an xs:dateTime."""

    description: str = ""
    author: str = ""
    version: str = ""
    copyright: str = ""
    license: str = ""
    tool: str = ""
    generated: str = ""


@dataclass(frozen=True)
class UnitDefinition:
    """A unit that an SSP file defines: SI value = factor * value + offset, in the base units of `dimension`."""

    name: str
    dimension: Dimension
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Transformation:
    """A connection's transformation after unit conversion: factor * value + offset, or another one in SSP's words.

    `table` is its SSP name, "BooleanMappingTransformation"; "" if it is linear.
    """

    factor: float = 1.0
    offset: float = 0.0
    table: str = ""


IDENTITY_TRANSFORMATION = Transformation()


@dataclass(frozen=True)
class ParameterValue:
    """A value that SSP assigns before a run to a variable, named relative to its component or system: "plant.k_s".

    The type is "Real", "Integer", "Boolean", "String", "Enumeration", "Binary", or of FMI 3.0: "Float64". Values are
    one or the elements of an array: numbers (0.0 and 1.0 for Boolean), text for String and for an item of an
    Enumeration, hexadecimal digits for Binary. The unit "" stands for the unit of the target. `description` is the
    source of the value, or "".
    """

    name: str
    type: str
    values: tuple[float, ...] | tuple[str, ...]
    unit: str = ""
    description: str = ""


@dataclass(frozen=True)
class ParameterSet:
    """An SSP parameter set with the `units` of its values; `source` is its .ssv in the archive, "" in the structure."""

    name: str
    parameters: tuple[ParameterValue, ...]
    units: tuple[UnitDefinition, ...] = ()
    source: str = ""
    metadata: Metadata = Metadata()
    annotations: tuple[Annotation, ...] = ()


@dataclass(frozen=True)
class MappingEntry:
    """An entry of a parameter mapping: a parameter of the set (`source`) and the variable that receives its value."""

    source: str
    target: str
    transformation: Transformation = IDENTITY_TRANSFORMATION
    suppress_unit_conversion: bool = False


@dataclass(frozen=True)
class ParameterMapping:
    """An SSP mapping from parameters to other variables; `source` is its file in the archive, "" in the structure."""

    entries: tuple[MappingEntry, ...]
    source: str = ""
    metadata: Metadata = Metadata()

    @cached_property
    def entries_of(self) -> dict[str, list[MappingEntry]]:
        """Mapping entries by source; a value may have several targets."""
        found: dict[str, list[MappingEntry]] = {}
        for entry in self.entries:
            found.setdefault(entry.source, []).append(entry)
        return found


@dataclass(frozen=True)
class ParameterBinding:
    """Parameter values for an SSP component, or all of a system: names get `prefix`; no `mapping`: equal names."""

    parameters: ParameterSet
    prefix: str = ""
    mapping: ParameterMapping | None = None


class ParseBudget:
    """A limit on the processor time that a file may take to read; larger files are assumed to be malicious."""

    def __init__(self, where: str):
        self._where = where
        # processor time, not wall-clock time: a busy machine must not reject a file
        self._end = time.process_time() + MAX_PARSE_TIME

    def spend(self) -> None:
        """Refuse the file if `MAX_PARSE_TIME` is exceeded; to be called once per element."""
        if time.process_time() > self._end:
            raise InputRefused(
                f"{self._where}: takes more than {MAX_PARSE_TIME:g} s to read; expected fewer connectors, connections "
                "and values. Do not trust this file"
            )


def local_name(element: ET.Element) -> str:
    """Return the name of an XML element without its namespace."""
    return element.tag.rpartition("}")[2]


def child_elements(element: ET.Element | None, name: str) -> list[ET.Element]:
    """Return the child elements called `name` of an XML element; empty if the element is None."""
    return [] if element is None else [child for child in element if local_name(child) == name]


def grouped_children(element: ET.Element, group: str, name: str) -> list[ET.Element]:
    """Return the child elements called `name` inside all child elements called `group`."""
    return [child for part in child_elements(element, group) for child in child_elements(part, name)]


def required_attribute(element: ET.Element, attribute: str, where: str) -> str:
    """Return the value of a mandatory XML attribute; refuse a missing or empty one."""
    found = element.get(attribute, "")
    if not found:
        raise InputRefused(f"{where}: a <{local_name(element)}> without {attribute}")
    return found


def require_unique(names: Iterable[str], what: str, where: str) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise InputRefused(f"{where}: two {what} are called '{name}'; expected different names")
        seen.add(name)


def number_attribute(element: ET.Element, attribute: str, where: str, default: Default) -> float | Default:
    """Return an XML attribute as a finite number, `default` if it is missing; refuse other text."""
    text = element.get(attribute)
    return default if text is None else parse_finite(text, f"{where}: <{local_name(element)}> {attribute}")


def parse_finite(text: str, where: str) -> float:
    value = parse_float(text)
    if value is None or not math.isfinite(value):
        raise InputRefused(f"{where} = '{text[:40]}'; expected a finite number")
    return value


def boolean_attribute(element: ET.Element, attribute: str, where: str) -> bool:
    """Whether an XML attribute is true (default false)."""
    text = element.get(attribute, "false").strip()
    if text not in BOOLEAN_VALUES:
        raise InputRefused(f"{where}: <{local_name(element)}> {attribute} = '{text[:40]}'; expected true or false")
    return BOOLEAN_VALUES[text]


def metadata_of(root: ET.Element) -> Metadata:
    return Metadata(*(root.get(name, "") for name in METADATA_ATTRIBUTES))


def annotations_of(element: ET.Element) -> tuple[Annotation, ...]:
    """Return the annotations of an SSP element; of each, only the first child element is kept."""
    return tuple(
        Annotation(one.get("type", ""), ET.tostring(one[0], encoding="unicode").strip() if len(one) else "")
        for one in grouped_children(element, "Annotations", "Annotation")
    )


def units_of(root: ET.Element, where: str) -> tuple[UnitDefinition, ...]:
    found = []
    for unit in grouped_children(root, "Units", "Unit"):
        name = required_attribute(unit, "name", where)
        base = next(iter(child_elements(unit, "BaseUnit")), None)
        if base is None:
            raise InputRefused(f"{where}: unit '{name}' without a BaseUnit")
        powers = [number_attribute(base, power, where, 0.0) for power in Dimension._fields]
        if not all(power.is_integer() and abs(power) <= MAX_POWER for power in powers):
            raise InputRefused(f"{where}: unit '{name}': expected small whole powers of its base units")
        factor = number_attribute(base, "factor", where, 1.0)
        if factor == 0.0:
            raise InputRefused(f"{where}: unit '{name}' has the factor 0; expected another number")
        found.append(
            UnitDefinition(name, Dimension(*map(int, powers)), factor, number_attribute(base, "offset", where, 0.0))
        )
    require_unique((unit.name for unit in found), "units", where)
    return tuple(found)


def transformation_of(element: ET.Element, where: str) -> Transformation:
    for child in element:
        if local_name(child) == "LinearTransformation":
            return Transformation(
                number_attribute(child, "factor", where, 1.0), number_attribute(child, "offset", where, 0.0)
            )
        if local_name(child).endswith("Transformation"):
            return Transformation(table=local_name(child))
    return IDENTITY_TRANSFORMATION


@dataclass(frozen=True)
class Connector:
    """A connector (input, output or parameter) of an SSP component (a variable of its FMU) or system.

    The type is "Real", "Float64", "Integer" ...; "" stands for the type or unit of the variable. `dimensions` are sizes
    of an array (SSP 2.0): numbers, or names of connectors that provide them.
    """

    name: str
    kind: ConnectorKind
    type: str = ""
    unit: str = ""
    dimensions: tuple[int | str, ...] = ()
    description: str = ""


@dataclass(frozen=True)
class SspComponent:
    """A component of an SSP system from an external file of a MIME `type`, usually an FMU, used as `implementation`.

    `name` is unique in its system; `source` a URI relative to the structure: "resources/plant.fmu". Connectors are
    declared; an FMU may have more variables. The last of the bindings takes precedence.
    """

    name: str
    source: str
    type: str = FMU_TYPE
    implementation: Implementation = "any"
    connectors: tuple[Connector, ...] = ()
    bindings: tuple[ParameterBinding, ...] = ()
    description: str = ""
    annotations: tuple[Annotation, ...] = ()

    @cached_property
    def connector_of(self) -> dict[str, Connector]:
        return {one.name: one for one in self.connectors}


class Endpoint(NamedTuple):
    """An end of an SSP connection; `element` is a component or system, "" for the enclosing system."""

    element: str
    connector: str


@dataclass(frozen=True)
class Connection:
    """An SSP connection; with `suppress_unit_conversion` only the transformation is applied to the value."""

    start: Endpoint
    end: Endpoint
    transformation: Transformation = IDENTITY_TRANSFORMATION
    suppress_unit_conversion: bool = False


@dataclass(frozen=True)
class SspSystem:
    """An SSP system of components and nested systems, joined by connections.

    `connectors` are its own, for the enclosing system. `bindings` have values "element.parameter" for all its elements.
    """

    name: str
    elements: tuple["SspComponent | SspSystem", ...]
    connections: tuple[Connection, ...] = ()
    connectors: tuple[Connector, ...] = ()
    bindings: tuple[ParameterBinding, ...] = ()
    description: str = ""
    annotations: tuple[Annotation, ...] = ()

    @cached_property
    def connector_of(self) -> dict[str, Connector]:
        return {one.name: one for one in self.connectors}

    @cached_property
    def element_of(self) -> dict[str, "SspComponent | SspSystem"]:
        return {one.name: one for one in self.elements}

    @cached_property
    def lengths(self) -> list[int]:
        """Lengths of the system's element names, in descending order."""
        return sorted({len(name) for name in self.element_of}, reverse=True)


@dataclass(frozen=True)
class DefaultExperiment:
    """Default start and stop time of a run (s); None if not stated. SSP does not define a step size."""

    start: float | None = None
    stop: float | None = None
    annotations: tuple[Annotation, ...] = ()


@dataclass(frozen=True)
class Structure:
    """Content of a SystemStructure.ssd (SSP version "1.0"): system, units of connectors, default experiment.

    `enumerations` are (name, (item, value) ...) each.
    """

    name: str
    system: SspSystem
    version: str = "1.0"
    units: tuple[UnitDefinition, ...] = ()
    enumerations: tuple[tuple[str, tuple[tuple[str, int], ...]], ...] = ()
    experiment: DefaultExperiment = DefaultExperiment()
    metadata: Metadata = Metadata()
    annotations: tuple[Annotation, ...] = ()
