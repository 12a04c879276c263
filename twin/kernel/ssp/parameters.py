"""SSP parameter values (SSV) and parameter mappings (SSM).

What files tell of themselves: who made them, and notes of tools that others may pass over. Units, and lines from one
value to another (SSP 1.0, 4.5.3 and 4.5.4).
"""

from dataclasses import dataclass
from functools import cached_property

from twin.kernel.units import Dimension


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


METADATA = ("description", "author", "fileversion", "copyright", "license", "generationTool", "generationDateAndTime")
"""What files call the fields of `Metadata`, in their order."""


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


NONE = Transformation()
"""The value as it is."""


PARAMETER_SET = "application/x-ssp-parameter-set"
PARAMETER_MAPPING = "application/x-ssp-parameter-mapping"
REALS = ("Real", "Float64", "Float32")
WHOLES = ("Integer", *(f"{sign}Int{bits}" for sign in ("", "U") for bits in (8, 16, 32, 64)))
"""Types whose values are numbers, the first of SSP 1.0, the others of 2.0."""


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
    transformation: Transformation = NONE
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
