"""Members of a system other than its FMUs: signals over time, tables, components in Python."""

from dataclasses import dataclass, field

from twin.kernel.cosim.component import Component
from twin.kernel.ssp.flat import UnitStep
from twin.kernel.ssp.structure import Endpoint


@dataclass(frozen=True)
class Feed:
    """A connection to an FMU input `end` (path, variable) from an output "component.port" of the master, like a signal.

    `by` is its origin, for messages, `unit` the unit of the value, "" for the variable's, `hops` its conversions.
    """

    end: Endpoint
    source: str
    by: str
    unit: str = ""
    hops: tuple[UnitStep, ...] = ()
    size: int = 1


@dataclass(frozen=True)
class SystemExtras:
    """Components of a system other than FMUs, and their connections.

    Attributes:
        components: all their outputs are recorded.
        feeds: connections to FMUs.
        drains: (output of an FMU, input in the master "component.port").
        wires: connections among these components, in the master's form.
        order: names of all components in step order; empty to step these before the FMUs.
        signals: names of components whose outputs are known before the first step.
        about: signal name -> its expression or file; part of the identity of a run.
        ignored: columns of files that feed nothing.
        spans: first and last sample time of each sampled signal (s).
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
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return SystemExtras(*(one | more if isinstance(one, dict) else one + more for one, more in pairs))
