"""The structure of an SSP system (SSD): components, connectors, connections; its parameter values (SSV, SSM).

Elements that all files of the standard share (SSC), read; by their names alone, as each name means one thing. What
files tell of themselves: who made them, and notes of tools that others may pass over. Units, and lines from one value
to another (SSP 1.0, 4.5.3 and 4.5.4).
"""

import math
import time
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

from twin.kernel.errors import InputRefused
from twin.kernel.units import Dimension

METADATA_ATTRIBUTES = (
    "description",
    "author",
    "fileversion",
    "copyright",
    "license",
    "generationTool",
    "generationDateAndTime",
)
"""What files call the fields of `Metadata`, in their order."""
PARAMETER_SET = "application/x-ssp-parameter-set"
PARAMETER_MAPPING = "application/x-ssp-parameter-mapping"
REAL_TYPES = ("Real", "Float64", "Float32")
INTEGER_TYPES = ("Integer", *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)))
"""Types whose values are numbers, the first of SSP 1.0, the others of 2.0."""
BOOLEAN_VALUES = {"true": True, "1": True, "false": False, "0": False}
MAX_POWER = 100
"""Of a base unit; an honest one has 4."""
MAX_PARSE_TIME = 30.0
"""s on a processor, for a structure and once more for what is made of it; the largest that is allowed takes a tenth."""
STRUCTURE_FILE = "SystemStructure.ssd"
"""Entry of an SSP archive."""
FMU_TYPE = "application/x-fmu-sharedlibrary"
TABLE_TYPE = "application/table"
"""Type of OMSimulator's components that are tables of values over time."""


@dataclass(frozen=True)
class Annotation:
    """A note.

    Attributes:
        type: its name, by reversed domain: "org.openmodelica".
        content: XML of what is in it, "" for nothing.
    """

    type: str
    content: str = ""


@dataclass(frozen=True)
class Metadata:
    """Of a file (SSP 1.0, 4.4.2); "" is not stated. `generated` is a date and time as xs:dateTime."""

    description: str = ""
    author: str = ""
    version: str = ""
    copyright: str = ""
    license: str = ""
    tool: str = ""
    generated: str = ""


@dataclass(frozen=True)
class UnitDefinition:
    """A unit as a file defines it: SI value = factor * value + offset, of a quantity of `dimension`."""

    name: str
    dimension: Dimension
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Transformation:
    """What is done to a value on its way, after its unit is converted: factor * value + offset.

    Attributes:
        factor, offset: of a LinearTransformation.
        table: the standard's name of one that is no line, "BooleanMappingTransformation"; "" if it is one.
    """

    factor: float = 1.0
    offset: float = 0.0
    table: str = ""


IDENTITY_TRANSFORMATION = Transformation()
"""The value as it is."""


@dataclass(frozen=True)
class ParameterValue:
    """A value for a parameter, or for whatever may be set before a run.

    Attributes:
        name: within what it is for: "plant.k_s".
        type: "Real", "Integer", "Boolean", "String", "Enumeration", "Binary", or one of FMI 3.0: "Float64".
        values: one, or as many as an array has: numbers (0.0 and 1.0 of a Boolean), text of a String and of an item
            of an Enumeration, hexadecimal digits of a Binary.
        unit: of a real number; "" where it is that of what takes the value.
        description: where the value comes from, or "".
    """

    name: str
    type: str
    values: tuple[float, ...] | tuple[str, ...]
    unit: str = ""
    description: str = ""


@dataclass(frozen=True)
class ParameterSet:
    """Values that belong together, and the `units` that they name.

    Attributes:
        source: the file of the archive in which it stands, "resources/plant.ssv"; "": in the structure itself.
    """

    name: str
    parameters: tuple[ParameterValue, ...]
    units: tuple[UnitDefinition, ...] = ()
    source: str = ""
    metadata: Metadata = Metadata()
    annotations: tuple[Annotation, ...] = ()


@dataclass(frozen=True)
class MappingEntry:
    """A parameter of the set (`source`) and what takes its value (`target`)."""

    source: str
    target: str
    transformation: Transformation = IDENTITY_TRANSFORMATION
    suppress_unit_conversion: bool = False


@dataclass(frozen=True)
class ParameterMapping:
    """Where values of a set go that do not go where their name says; `source` as of a `ParameterSet`."""

    entries: tuple[MappingEntry, ...]
    source: str = ""
    metadata: Metadata = Metadata()

    @cached_property
    def entries_of(self) -> dict[str, list[MappingEntry]]:
        """By source: a value may go to several places."""
        found: dict[str, list[MappingEntry]] = {}
        for entry in self.entries:
            found.setdefault(entry.source, []).append(entry)
        return found


@dataclass(frozen=True)
class ParameterBinding:
    """A set of values for a component, or for all that is in a system.

    Attributes:
        parameters: the values.
        prefix: put in front of the name of each.
        mapping: None: each goes where its name says.
    """

    parameters: ParameterSet
    prefix: str = ""
    mapping: ParameterMapping | None = None


class ParseBudget:
    """What lasts too long is refused: no file that an honest tool writes needs that.

    Args:
        where: for the sentence.
    """

    def __init__(self, where: str):
        self._where = where
        # not the clock's: a busy machine accuses no file
        self._end = time.process_time() + MAX_PARSE_TIME

    def spend(self) -> None:
        """To be called for each of what there may be many of.

        Raises:
            InputRefused: it has lasted too long.
        """
        if time.process_time() > self._end:
            raise InputRefused(
                f"{self._where}: takes more than {MAX_PARSE_TIME:g} s to read; expected fewer connectors, connections and "
                "values. Do not trust this file"
            )


def local_name(element: ET.Element) -> str:
    """The name of an element without its namespace."""
    return element.tag.rpartition("}")[2]


def child_elements(element: ET.Element | None, name: str) -> list[ET.Element]:
    """The children called `name`; none of no element."""
    return [] if element is None else [child for child in element if local_name(child) == name]


def grouped_children(element: ET.Element, group: str, name: str) -> list[ET.Element]:
    """The children called `name` of the child called `group`."""
    return [child for part in child_elements(element, group) for child in child_elements(part, name)]


def required_attribute(element: ET.Element, attribute: str, where: str) -> str:
    """An attribute that has to be there.

    Raises:
        InputRefused: it is not.
    """
    found = element.get(attribute, "")
    if not found:
        raise InputRefused(f"{where}: a <{local_name(element)}> without {attribute}")
    return found


def require_unique(names: Iterable[str], what: str, where: str) -> None:
    """See that no name comes twice.

    Raises:
        InputRefused: one does.
    """
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise InputRefused(f"{where}: two {what} are called '{name}'; expected different names")
        seen.add(name)


def number_attribute(element: ET.Element, attribute: str, where: str, default: float) -> float:
    """The finite number of an attribute, `default` without it.

    Raises:
        InputRefused: it is none.
    """
    text = element.get(attribute)
    return default if text is None else parse_finite(text, f"{where}: <{local_name(element)}> {attribute}")


def parse_finite(text: str, where: str) -> float:
    """The finite number that `text` says.

    Raises:
        InputRefused: it says none.
    """
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputRefused(f"{where} = '{text[:40]}'; expected a finite number")
    return value


def boolean_attribute(element: ET.Element, attribute: str, where: str) -> bool:
    """Whether it says so; no if it says nothing.

    Raises:
        InputRefused: neither true nor false.
    """
    text = element.get(attribute, "false").strip()
    if text not in BOOLEAN_VALUES:
        raise InputRefused(f"{where}: <{local_name(element)}> {attribute} = '{text[:40]}'; expected true or false")
    return BOOLEAN_VALUES[text]


def metadata_of(root: ET.Element) -> Metadata:
    """Of a file."""
    return Metadata(*(root.get(name, "") for name in METADATA_ATTRIBUTES))


def annotations_of(element: ET.Element) -> tuple[Annotation, ...]:
    """Of an element; of each only the first element that is in it."""
    return tuple(
        Annotation(one.get("type", ""), ET.tostring(one[0], encoding="unicode").strip() if len(one) else "")
        for one in grouped_children(element, "Annotations", "Annotation")
    )


def units_of(root: ET.Element, where: str) -> tuple[UnitDefinition, ...]:
    """That a file defines.

    Raises:
        InputRefused: a unit without a name, one defined twice, or powers that are no small whole numbers.
    """
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
    """That of a connection or of an entry of a mapping.

    Raises:
        InputRefused: a factor or an offset is no finite number.
    """
    for child in element:
        if local_name(child) == "LinearTransformation":
            return Transformation(
                number_attribute(child, "factor", where, 1.0), number_attribute(child, "offset", where, 0.0)
            )
        if local_name(child).endswith("Transformation"):
            return Transformation(table=local_name(child))
    return IDENTITY_TRANSFORMATION


ConnectorKind = Literal[
    "input", "output", "inout", "parameter", "calculatedParameter", "structuralParameter", "constant", "local"
]
"""As the standard calls them; the last three are of SSP 2.0."""
Implementation = Literal["any", "CoSimulation", "ModelExchange", "ScheduledExecution"]


@dataclass(frozen=True)
class Connector:
    """Where a component or a system can be connected.

    Attributes:
        name: of an FMU the variable's.
        kind: what it is for.
        type: "Real", "Float64", "Integer" ..; "": that of the variable.
        unit: "": that of the variable.
        dimensions: of an array (SSP 2.0), each a number or the name of the connector that says it.
        description: or "".
    """

    name: str
    kind: ConnectorKind
    type: str = ""
    unit: str = ""
    dimensions: tuple[int | str, ...] = ()
    description: str = ""


@dataclass(frozen=True)
class SspComponent:
    """A part that somebody else has made, as a rule an FMU.

    Attributes:
        name: unique in its system.
        source: URI, relative to the structure: "resources/plant.fmu".
        type: MIME type of what is there.
        implementation: as which an FMU is to be used.
        connectors: the listed ones; an FMU may have more variables.
        bindings: values for its parameters, the last one counts.
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
        """Its connectors by name."""
        return {one.name: one for one in self.connectors}


class Endpoint(NamedTuple):
    """Where a connection begins or ends; `element` is a component or system, "" for the system it stands in."""

    element: str
    connector: str


@dataclass(frozen=True)
class Connection:
    """What goes from one connector to another.

    Attributes:
        suppress_unit_conversion: the transformation is all that is done to the value.
    """

    start: Endpoint
    end: Endpoint
    transformation: Transformation = IDENTITY_TRANSFORMATION
    suppress_unit_conversion: bool = False


@dataclass(frozen=True)
class SspSystem:
    """Components, and systems in the system, joined by connections.

    Attributes:
        connectors: its own, for the system around it.
        bindings: values for parameters of all that is in it, "element.parameter".
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
        """Its own connectors by name."""
        return {one.name: one for one in self.connectors}

    @cached_property
    def element_of(self) -> dict[str, "SspComponent | SspSystem"]:
        """What is in it by name."""
        return {one.name: one for one in self.elements}

    @cached_property
    def lengths(self) -> list[int]:
        """Of the names of what is in it, the longest first."""
        return sorted({len(name) for name in self.element_of}, reverse=True)


@dataclass(frozen=True)
class DefaultExperiment:
    """How long the system is run if nothing else is said (s); None: not stated. The standard has no word for steps."""

    start: float | None = None
    stop: float | None = None
    annotations: tuple[Annotation, ...] = ()


@dataclass(frozen=True)
class Structure:
    """All of a SystemStructure.ssd.

    Attributes:
        version: of the standard, "1.0".
        units: that connectors name.
        enumerations: by name, the value of each item.
    """

    name: str
    system: SspSystem
    version: str = "1.0"
    units: tuple[UnitDefinition, ...] = ()
    enumerations: tuple[tuple[str, tuple[tuple[str, int], ...]], ...] = ()
    experiment: DefaultExperiment = DefaultExperiment()
    metadata: Metadata = Metadata()
    annotations: tuple[Annotation, ...] = ()
