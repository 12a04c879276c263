"""The structure of a system (SSD): its components, and what leads where."""

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

from twin.cosim.ssp.metadata import Annotation, Metadata
from twin.cosim.ssp.parameters import ParameterBinding
from twin.cosim.ssp.unit import NONE, Transformation, UnitDefinition

STRUCTURE = "SystemStructure.ssd"
"""Entry of an SSP archive."""
FMU = "application/x-fmu-sharedlibrary"

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
        connectors: that are told of; an FMU may have more variables.
        bindings: values for its parameters, the last one counts.
    """

    name: str
    source: str
    type: str = FMU
    implementation: Implementation = "any"
    connectors: tuple[Connector, ...] = ()
    bindings: tuple[ParameterBinding, ...] = ()
    description: str = ""
    annotations: tuple[Annotation, ...] = ()

    @cached_property
    def connector_of(self) -> dict[str, Connector]:
        """Its connectors by name."""
        return {one.name: one for one in self.connectors}


class End(NamedTuple):
    """Where a connection begins or ends; `element` is a component or system, "" for the system it stands in."""

    element: str
    connector: str


@dataclass(frozen=True)
class Connection:
    """What goes from one connector to another.

    Attributes:
        suppress_unit_conversion: the transformation is all that is done to the value.
    """

    start: End
    end: End
    transformation: Transformation = NONE
    suppress_unit_conversion: bool = False


@dataclass(frozen=True)
class SspSystem:
    """Components, and systems in the system, joined by connections.

    Attributes:
        connectors: its own, for whoever puts it into another one.
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
    metadata: Metadata = Metadata()  # noqa: RUF009, it is frozen
    annotations: tuple[Annotation, ...] = ()
