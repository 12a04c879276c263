"""A flattened SSP system: components by path, connections, parameter values."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import NamedTuple

from twin.kernel.errors import InputRefused
from twin.kernel.ssp import structure as ssp

SOURCE_KINDS = ("output", "calculatedParameter", "constant", "local")
SINK_KINDS = ("input", "parameter", "structuralParameter")
"""Kinds of connectors that are sources and sinks of values; a system's own are swapped if seen from inside."""
MAX_BINDINGS = 1_000_000
"""Maximum number of parameter values assigned to variables, of all components together."""


class UnitStep(NamedTuple):
    """A step of a value over SSP connections: conversion to the target unit, unless suppressed, then a transformation.

    The transformation is of a connection or mapping entry. `unit` is of the system connector where the step ends, "" if
    it does not change, or for the last step.
    """

    transformation: ssp.Transformation = ssp.IDENTITY_TRANSFORMATION
    suppress: bool = False
    unit: str = ""


@dataclass(frozen=True)
class Lead:
    """A connection from one component's output to another's input (path, connector), with conversions in order."""

    start: ssp.Endpoint
    end: ssp.Endpoint
    hops: tuple[UnitStep, ...]


@dataclass(frozen=True)
class AssignedValue:
    """A value of a parameter set, which defines `units`, assigned to a variable with conversions `hops`, in order."""

    value: ssp.ParameterValue
    units: tuple[ssp.UnitDefinition, ...]
    hops: tuple[UnitStep, ...]


@dataclass(frozen=True)
class FlatSystem:
    """An SSP system whose subsystems are dissolved into one list of components and connections.

    Components are by path ("motor", "arm.motor"), in file order, with at most one lead per input. `assigned` has the
    value of highest precedence by path and variable. `ignored` are names in parameter sets that match no variable.
    `entrances` are the component inputs that an input connector of the outermost system feeds, with conversions;
    `exits` the connections that feed its output connectors.
    """

    components: dict[str, ssp.SspComponent]
    leads: tuple[Lead, ...]
    assigned: dict[str, dict[str, AssignedValue]]
    ignored: tuple[str, ...]
    entrances: dict[str, tuple[tuple[ssp.Endpoint, tuple[UnitStep, ...]], ...]] = field(default_factory=dict)
    exits: dict[str, Lead] = field(default_factory=dict)


def flatten(structure: ssp.Structure, where: str) -> FlatSystem:
    """Flatten the nested systems of an SSP structure into one list of components and connections."""
    return _Flattener(structure.system, where).system()


class _Flattener:
    """Components, systems and connections of nested systems, as a graph.

    A node is an `Endpoint` whose element is the path of a component or system ("" for the outermost system).
    """

    def __init__(self, outermost: ssp.SspSystem, where: str):
        self._where = where
        self._components: dict[str, ssp.SspComponent] = {}
        self._systems: dict[str, ssp.SspSystem] = {"": outermost}
        self._into: dict[ssp.Endpoint, tuple[ssp.Endpoint, ssp.Connection]] = {}
        self._out: dict[ssp.Endpoint, list[tuple[ssp.Endpoint, ssp.Connection]]] = {}
        self._assigned: dict[str, dict[str, AssignedValue]] = {}
        self._ignored: dict[str, None] = {}
        self._count = 0
        self._budget = ssp.ParseBudget(where)
        self._visit(outermost, "")

    def system(self) -> FlatSystem:
        leads = [self._lead(end) for end in self._into if end.element in self._components]
        self._assign(self._systems[""], "")
        entrances = {
            one.name: tuple(self._forward(ssp.Endpoint("", one.name), (UnitStep(unit=one.unit),)))
            for one in self._systems[""].connectors
            # connectors that a connection feeds are not entrances
            if one.kind in ("input", "inout") and ssp.Endpoint("", one.name) not in self._into
        }
        found = {end.connector: self._lead(end) for end in self._into if not end.element}
        exits = {name: lead for name, lead in found.items() if lead}
        given = tuple(lead for lead in leads if lead)
        return FlatSystem(self._components, given, self._assigned, tuple(self._ignored), entrances, exits)

    def _visit(self, system: ssp.SspSystem, path: str) -> None:
        for part in system.elements:
            below = f"{path}.{part.name}" if path else part.name
            if below in self._components or below in self._systems:
                raise InputRefused(f"{self._where}: two elements have the path '{below}'; expected different names")
            if isinstance(part, ssp.SspSystem):
                self._systems[below] = part
                self._visit(part, below)
            else:
                self._components[below] = part
        for connection in system.connections:
            self._budget.spend()
            start, end = self._orient(connection, path, system)
            if end in self._into:
                first, second = _text(self._into[end][0]), _text(start)
                raise InputRefused(
                    f"{self._where}: {_text(end)} is fed by two connections, from {first} and from {second}; remove one"
                )
            self._into[end] = start, connection
            self._out.setdefault(start, []).append((end, connection))

    def _orient(
        self, connection: ssp.Connection, path: str, system: ssp.SspSystem
    ) -> tuple[ssp.Endpoint, ssp.Endpoint]:
        """Return (source, sink) of an SSP connection, derived from the kinds of its connectors."""
        start, end = (self._node(at, path, system) for at in (connection.start, connection.end))
        gives = [self._gives(at, inside) for at, inside in ((start, connection.start), (end, connection.end))]
        if None not in gives and gives[0] == gives[1]:
            both = "give values" if gives[0] else "take values"
            raise InputRefused(
                f"{self._where}: the connection of {_text(start)} and {_text(end)}, which both {both}; expected one of "
                "each kind"
            )
        return (end, start) if gives[0] is False or gives[1] is True else (start, end)

    def _gives(self, node: ssp.Endpoint, stated: ssp.Endpoint) -> bool | None:
        """Whether a connector is a source at an SSP connection (True), a sink (False), or does not state it (None)."""
        within = self._systems.get(node.element)
        owner = within or self._components[node.element]
        found = owner.connector_of.get(node.connector)
        kind = found.kind if found else ""
        if kind not in (*SOURCE_KINDS, *SINK_KINDS):
            return None
        # seen from inside, a system's own inputs are sources and its outputs sinks
        return (kind in SOURCE_KINDS) == bool(stated.element)

    def _node(self, end: ssp.Endpoint, path: str, system: ssp.SspSystem) -> ssp.Endpoint:
        if not end.element:
            self._require_connector(system, end.connector, path)
            return ssp.Endpoint(path, end.connector)
        part = system.element_of.get(end.element)
        if part is None:
            known = ", ".join(part.name for part in system.elements)
            raise InputRefused(
                f"{self._where}: a connection with '{end.element}', which is not an element of '{system.name}'; it has "
                f"{known or 'none'}"
            )
        below = f"{path}.{part.name}" if path else part.name
        if isinstance(part, ssp.SspSystem):
            self._require_connector(part, end.connector, below)
        return ssp.Endpoint(below, end.connector)

    def _require_connector(self, system: ssp.SspSystem, connector: str, path: str) -> ssp.Connector:
        found = system.connector_of.get(connector)
        if found is None:
            raise InputRefused(
                f"{self._where}: a connection with '{connector}', which is not a connector of the system "
                f"'{path or system.name}'"
            )
        return found

    def _lead(self, end: ssp.Endpoint) -> Lead | None:
        """Return the connection between components that ends at `end`; None if it starts outside the system."""
        hops: list[UnitStep] = []
        node, seen = end, {end}
        while node in self._into:
            self._budget.spend()
            start, connection = self._into[node]
            hops.append(self._unit_step(node, connection))
            if start in seen:
                raise InputRefused(
                    f"{self._where}: what feeds {_text(end)} leads in a circle through {_text(start)}, a connector of "
                    "a system; a value has to come from a component"
                )
            seen.add(start)
            node = start
            if node.element in self._components:
                return Lead(node, end, tuple(reversed(hops)))
        return None

    def _unit_step(self, end: ssp.Endpoint, connection: ssp.Connection) -> UnitStep:
        unit = ""
        if end.element in self._systems:
            unit = self._require_connector(self._systems[end.element], end.connector, end.element).unit
        return UnitStep(connection.transformation, connection.suppress_unit_conversion, unit)

    def _assign(self, system: ssp.SspSystem, path: str) -> None:
        """Assign parameter values, inner systems first, as outer values take precedence."""
        for part in system.elements:
            below = f"{path}.{part.name}" if path else part.name
            if isinstance(part, ssp.SspSystem):
                self._assign(part, below)
            else:
                self._bind(part.bindings, below)
        self._bind(system.bindings, path)

    def _bind(self, bindings: tuple[ssp.ParameterBinding, ...], path: str) -> None:
        for binding in bindings:
            for value in binding.parameters.parameters:
                self._budget.spend()
                name = binding.prefix + value.name
                entries = binding.mapping.entries_of.get(name, []) if binding.mapping else []
                targets: list[tuple[str, tuple[UnitStep, ...]]] = [
                    (one.target, (UnitStep(one.transformation, one.suppress_unit_conversion),)) for one in entries
                ]
                for target, hops in targets or [(name, ())]:
                    reached = list(self._resolve(target, path, hops))
                    for end, way in reached:
                        self._count += 1
                        if self._count > MAX_BINDINGS:
                            raise InputRefused(f"{self._where}: more than {MAX_BINDINGS} values; do not trust it")
                        given = AssignedValue(value, binding.parameters.units, way)
                        self._assigned.setdefault(end.element, {})[end.connector] = given
                    if not reached:
                        self._ignored[f"{path}.{target}" if path else target] = None

    def _resolve(
        self, name: str, path: str, hops: tuple[UnitStep, ...]
    ) -> Iterator[tuple[ssp.Endpoint, tuple[UnitStep, ...]]]:
        """Yield the component variables that a parameter `name`, relative to `path`, refers to."""
        if path in self._components:
            yield ssp.Endpoint(path, name), hops
            return
        system = self._systems[path]
        own = system.connector_of.get(name)
        if own is not None:
            led = (*hops[:-1], hops[-1]._replace(unit=own.unit)) if hops else (UnitStep(unit=own.unit),)
            yield from self._forward(ssp.Endpoint(path, name), led)
            return
        # element names may contain dots
        inner = next((name[:n] for n in system.lengths if name[n : n + 1] == "." and name[:n] in system.element_of), "")
        if inner:
            yield from self._resolve(name[len(inner) + 1 :], f"{path}.{inner}" if path else inner, hops)

    def _forward(
        self, start: ssp.Endpoint, hops: tuple[UnitStep, ...]
    ) -> Iterator[tuple[ssp.Endpoint, tuple[UnitStep, ...]]]:
        """Yield the component inputs that a system's connector feeds; at most one path leads to each."""
        seen, ahead = {start}, [(start, hops)]
        while ahead:
            self._budget.spend()
            node, way = ahead.pop()
            if node.element in self._components:
                yield node, way
                continue
            # reversed: a stack, and the first connection shall be followed first
            for end, connection in reversed(self._out.get(node, [])):
                if end not in seen:
                    seen.add(end)
                    ahead.append((end, (*way, self._unit_step(end, connection))))


def _text(end: ssp.Endpoint) -> str:
    return f"{end.element}.{end.connector}" if end.element else end.connector
