"""What takes part in a system beside its FMUs: signals over time, tables, components in Python."""

from dataclasses import dataclass, field

from twin.kernel.cosim.component import Component
from twin.kernel.ssp.flat import UnitStep
from twin.kernel.ssp.structure import Endpoint


@dataclass(frozen=True)
class Feed:
    """What feeds an input of an FMU from beside.

    Attributes:
        end: the component's path and the variable.
        source: output of the master, "component.port".
        by: who says so, for sentences.
        unit: of the value; "": that of the variable.
        hops: on its way.
        size: how many values.
    """

    end: Endpoint
    source: str
    by: str
    unit: str = ""
    hops: tuple[UnitStep, ...] = ()
    size: int = 1


@dataclass(frozen=True)
class SystemExtras:
    """All of it.

    Attributes:
        components: with what they do; each of their outputs is recorded.
        feeds: into FMUs.
        drains: (output of an FMU, input of the master "component.port").
        wires: among these components, as the master takes them.
        order: of all components by name, those of the master; (): these before the FMUs.
        about: of each signal by its name, what it is made of; it belongs to the identity of a run.
        signals: names of components whose outputs are known before the first step.
        ignored: columns of files that feed nothing.
        spans: of each signal that has samples, the first and the last time (s).
    """

    components: tuple[Component, ...] = ()
    feeds: tuple[Feed, ...] = ()
    drains: tuple[tuple[Endpoint, str], ...] = ()
    wires: tuple[tuple[str, str], ...] = ()
    order: tuple[str, ...] = ()
    signals: tuple[str, ...] = ()
    about: dict[str, str] = field(default_factory=dict)
    ignored: tuple[str, ...] = ()
    spans: dict[str, tuple[float, float]] = field(default_factory=dict)

    def __add__(self, other: "SystemExtras") -> "SystemExtras":
        """Both together."""
        return SystemExtras(
            self.components + other.components,
            self.feeds + other.feeds,
            self.drains + other.drains,
            self.wires + other.wires,
            self.order + other.order,
            self.signals + other.signals,
            self.about | other.about,
            self.ignored + other.ignored,
            self.spans | other.spans,
        )
