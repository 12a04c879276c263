"""Plan of a system: FMUs checked, connections and values converted; no binary is loaded."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path

from twin.kernel.cosim.interpolation import Scheme
from twin.kernel.errors import InputRefused, nearest
from twin.kernel.fmi.description import KIND_NAMES, NEEDS_TOOL, FmuDescription, Kind, described
from twin.kernel.fmi.stepping import FmuPort
from twin.kernel.fmi.variable import Setting, Value, Variable, conversion, given_values, parse_number, setting_value
from twin.kernel.recording.writer import EVENTS_TOPIC
from twin.kernel.ssp.flat import AssignedValue, FlatSystem, Lead, UnitStep
from twin.kernel.ssp.package import Package
from twin.kernel.ssp.structure import FMU_TYPE, REAL_TYPES, Connector, Endpoint, Implementation
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.extras import Feed, SystemExtras
from twin.kernel.systems.naming import (
    SINGLE_FORM,
    distinct_ports,
    match_names,
    port_of,
    topic_name,
    type_rank,
    unique_names,
)
from twin.kernel.systems.timing import Timing, step_order, timing
from twin.kernel.systems.unit_conversion import connection_map, parse_unit, unit_of_variable

MAX_HINT_NAMES = 1000
"""Maximum number of names that are searched for a suggestion."""
IMPLEMENTATION_KINDS: Mapping[Implementation, Kind | None] = {
    "any": None,
    "CoSimulation": "co_simulation",
    "ModelExchange": "model_exchange",
}
SETTABLE_CAUSALITIES = ("parameter", "structuralParameter", "input")
STARTING_INITIALS = ("exact", "approx")
"""Variables that can be set before a run: these causalities, or an own start value (SSP 1.0, 5.3.5)."""


@dataclass(frozen=True)
class SystemPart:
    """An FMU component of a planned system: its path there, its name in the master and of its topic.

    Parameters that size arrays are applied to the description. Connected inputs are scaled for their sources, outputs
    are not. The first `recorded` outputs are recorded, others only read. `settings` are values before initialisation,
    and `unfed` inputs have no source.
    """

    path: str
    name: str
    description: FmuDescription
    inputs: tuple[FmuPort, ...]
    outputs: tuple[FmuPort, ...]
    recorded: int
    settings: tuple[Setting, ...]
    unfed: tuple[Variable, ...]


@dataclass(frozen=True)
class SystemPlan:
    """A checked co-simulation system, ready to be coupled, with parts in step order.

    Wires are (output, input) in the master, "part.port" each. `ignored` are names with values that match no variable,
    `forgiven` accepted violations of files, `overruled` settings and SSV parameters of inputs that connections feed,
    `unreadable` local variables that their FMU does not return, and that are not recorded.
    """

    package: Package
    parts: tuple[SystemPart, ...]
    wires: tuple[tuple[str, str], ...]
    timing: Timing
    choice: MasterChoice
    ignored: tuple[str, ...]
    forgiven: tuple[str, ...] = ()
    extras: SystemExtras = field(default_factory=SystemExtras)
    overruled: tuple[str, ...] = ()
    unreadable: tuple[str, ...] = ()

    @property
    def scheme(self) -> Scheme:
        """Coupling scheme of the master: chosen by the user, else the default of the file format."""
        return self.choice.scheme or self.package.scheme

    @property
    def delayed_connections(self) -> list[tuple[str, str]]:
        """(Output, input) that carry values from the step's start: in Gauss-Seidel those against its order."""
        order = {part.name: number for number, part in enumerate(self.parts)}
        outputs, inputs = (
            {
                f"{part.name}.{port.port.name}": f"{part.path}.{port.variable.name}"
                for part in self.parts
                for port in getattr(part, side)
            }
            for side in ("outputs", "inputs")
        )
        return [
            (outputs[source], inputs[target])
            for source, target in self.wires
            if source in outputs
            and target in inputs
            and (self.scheme == "jacobi" or order[source.partition(".")[0]] >= order[target.partition(".")[0]])
        ]


def fmu_sources(package: Package, flat: FlatSystem) -> dict[str, str]:
    """Return the archive entry of each component's FMU, by component path."""
    if not flat.components:
        raise InputRefused(f"{package.file}: a system without components; expected at least one")
    found = {}
    for path, component in flat.components.items():
        where = f"{package.file}: component '{path}'"
        if component.type not in (FMU_TYPE, ""):
            raise InputRefused(f"{where} is of type {component.type}, which is not supported; expected {FMU_TYPE}")
        if component.implementation not in IMPLEMENTATION_KINDS:
            raise InputRefused(
                f"{where} is to be used for {component.implementation}, which is not supported; expected an FMU for "
                "co-simulation or model exchange"
            )
        found[path] = package.entry(component.source)
        if not found[path]:
            raise InputRefused(f"{where}: its resource '{component.source}' is not a file of this archive")
    return found


def plan_system(
    package: Package,
    flat: FlatSystem,
    files: Mapping[str, Path],
    choice: MasterChoice,
    beside: SystemExtras = SystemExtras(),  # noqa: B008, it is frozen
    patterns: Sequence[str] = (),
    when: Timing | None = None,
) -> SystemPlan:
    """Plan a co-simulation system: choose FMU kinds, check connections, and convert units and values.

    `files` are FMUs by entry, `beside` components other than FMUs. `patterns` name the signals to record: all outputs
    and all sources of connections by default. Without `when`, `timing` determines times and steps.
    """
    choice.refuse_unknown(flat.components, f"{package.file}")
    reader = _Planner(package, flat, files, choice, beside, patterns)
    parts = tuple(reader.part(path) for path in step_order(package, flat, choice))
    used = {part.path: part.description for part in parts}
    choice.refuse_idle(used, choice.scheme or package.scheme, f"{package.file}")
    if not any(part.recorded for part in parts):
        raise InputRefused(f"{package.file}: no FMU has an output that is a number; there is nothing to record")
    when = when or timing(package, flat, used, choice)
    begin, end = when.first * when.tick, when.ticks * when.tick
    for name, (first, last) in beside.spans.items():
        if first > end or last < begin:
            raise InputRefused(
                f"{package.file}: --input {name}: its samples are from {first:g} to {last:g} s, the run from {begin:g} "
                f"to {end:g} s; expected samples inside the run: shift their times, or give --start-s and --stop-s"
            )
    ignored = (*flat.ignored, *reader.ignored, *beside.ignored)
    offences = [*reader.forgiven, *([f"{package.file.name}: {when.rounded}"] if when.rounded else [])]
    wires, forgiven = tuple(reader.wires()), tuple(dict.fromkeys(offences))
    return SystemPlan(package, parts, wires, when, choice, ignored, forgiven, beside)


def _choose_kind(
    file: Path, stated: Implementation, path: str, choice: MasterChoice, read: Callable[..., FmuDescription]
) -> FmuDescription:
    """Describe a component's FMU as the kind chosen by name, else stated in the file, else chosen for all."""
    usual = read(file)
    named, stated_kind = choice.kinds.get(path), IMPLEMENTATION_KINDS[stated]
    kind = named or stated_kind
    if kind is None:
        # a choice for all components applies only to FMUs that support it
        every = choice.kinds.get("")
        return read(file, every) if every in usual.kinds else usual
    if kind not in usual.kinds:
        who = f"--kind {path}={kind}" if named else f"its component {path} is to be used for {KIND_NAMES[kind]}"
        raise InputRefused(f"{file}: offers {KIND_NAMES[usual.kinds[0]]} alone, and {who}; export it for that, too")
    return read(file, kind)


class _Planner:
    """Planner of a system's FMU components and wires."""

    def __init__(
        self,
        package: Package,
        flat: FlatSystem,
        files: Mapping[str, Path],
        choice: MasterChoice,
        beside: SystemExtras,
        patterns: Sequence[str],
    ):
        self._package, self._flat, self._units, self._beside = package, flat, package.structure.units, beside
        self.ignored: list[str] = []
        self.forgiven: list[str] = []
        self._lenient = choice.lenient
        self._descriptions: dict[str, FmuDescription] = {}
        self._given: dict[str, dict[str, Value]] = {}
        # every recording has the topic /events
        taken = [EVENTS_TOPIC, *(one.name for one in beside.components)]
        names = unique_names([*taken, *(topic_name(path) for path in flat.components)])[len(taken) :]
        self._names = dict(zip(flat.components, names, strict=True))
        read = cache(partial(described, lenient=choice.lenient))
        for path, entry in fmu_sources(package, flat).items():
            stated = flat.components[path].implementation
            plain = self._without_brackets(_choose_kind(files[entry], stated, path, choice, read))
            if plain.needs_tool:
                self.forgiven.append(f"{plain.path.name}: {plain.tool_note or NEEDS_TOOL}")
            self._given[path] = dict(self._values(path, plain))
            self._descriptions[path] = plain.with_sizes(
                {name: float(value) for name, value in self._given[path].items() if isinstance(value, (int, float))}
            )
        self._refuse_repeated_single_instance()
        self._into: dict[str, list[tuple[Endpoint | str, FmuPort]]] = {path: [] for path in flat.components}
        sources: dict[str, dict[str, None]] = {path: {} for path in flat.components}
        for start in (*(lead.start for lead in flat.leads), *(start for start, _ in beside.drains)):
            sources[start.element][start.connector] = None
        chosen = self._match_patterns(patterns)
        self._recorded: dict[str, int] = {}
        self._outputs = {path: self._output_ports(path, sources[path], chosen) for path in flat.components}
        for lead in flat.leads:
            self._into[lead.end.element].append((lead.start, self._lead_port(lead)))
        for feed in beside.feeds:
            self._into[feed.end.element].append((feed.source, self._feed_port(feed)))
        self._ports = {path: distinct_ports([port for _, port in self._into[path]]) for path in self._into}

    def part(self, path: str) -> SystemPart:
        description = self._descriptions[path]
        fed = {port.variable.name for _, port in self._into[path]}
        unfed = tuple(v for v in description.variables_of("input") if v.name not in fed)
        started = {v.name for v in description.model.modelVariables if v.start is not None} | set(self._given[path])
        for variable in unfed:
            if variable.name not in started:
                raise InputRefused(
                    f"{self._package.file}: input {path}.{variable.name} has no source and no start value; "
                    "connect it, or give it one in a parameter set, by --set or --input"
                )
        settings = [
            (variable, setting_value(description.path, variable, value))
            for name, value in self._given[path].items()
            if (variable := description.variables[name])
        ]
        inputs, outputs, recorded = tuple(self._ports[path]), self._outputs[path], self._recorded[path]
        return SystemPart(path, self._names[path], description, inputs, outputs, recorded, tuple(settings), unfed)

    def wires(self) -> Iterator[tuple[str, str]]:
        for path, into in self._into.items():
            for (source, _), port in zip(into, self._ports[path], strict=True):
                wire = source if isinstance(source, str) else self._output(source)
                yield wire, f"{self._names[path]}.{port.port.name}"
        yield from ((self._output(start), target) for start, target in self._beside.drains)
        yield from self._beside.wires

    def _output(self, start: Endpoint) -> str:
        port = next(port for port in self._outputs[start.element] if port.variable.name == start.connector)
        return f"{self._names[start.element]}.{port.port.name}"

    def _refuse_repeated_single_instance(self) -> None:
        seen: dict[str, str] = {}
        for path, description in self._descriptions.items():
            if description.single_instance and (other := seen.setdefault(description.sha256, path)) != path:
                raise InputRefused(
                    f"{description.path}: can be instantiated only once in a process "
                    f"(canBeInstantiatedOnlyOncePerProcess); the system needs it for {other} and for {path}"
                )

    def _values(self, path: str, description: FmuDescription) -> Iterator[tuple[str, Value]]:
        started = {v.name for v in description.model.modelVariables if v.initial in STARTING_INITIALS}
        for name, assigned in self._flat.assigned.get(path, {}).items():
            variable = description.variables.get(name)
            if variable is None:
                self.ignored.append(f"{path}.{name}")
                continue
            where = f"{self._package.file}: {path}.{name}"
            if variable.variability == "constant" or (
                variable.causality not in SETTABLE_CAUSALITIES and name not in started
            ):
                raise InputRefused(
                    f"{where}: cannot be set, being {variable.causality} without a start value; parameters, inputs and "
                    "start values can"
                )
            yield name, self._value(assigned, variable, description, path, where)

    def _value(
        self, assigned: AssignedValue, variable: Variable, description: FmuDescription, path: str, where: str
    ) -> Value:
        values = given_values(assigned.value, where)
        if self._lenient and not variable.is_text:
            values = self._item_numbers(values, where)
        if isinstance(values[0], str):
            if any(hop.transformation.table for hop in assigned.hops):
                raise InputRefused(f"{where}: a transformation of text, which is not supported")
            return values[0] if len(values) == 1 else [str(value) for value in values]
        own = unit_of_variable(variable.unit, self._connector(path, variable.name), self._units, description, where)
        start = parse_unit(self._unit(assigned.value.unit, where), (*assigned.units, *self._units), description)
        led = connection_map(start, self._hops(assigned.hops or (UnitStep(),), where), own, self._units, where)
        for value in values:
            # check the exact integer, which a double would round
            if isinstance(value, int) and variable.type not in REAL_TYPES and (why := variable.range_error(value)):
                raise InputRefused(f"{where} = {value}: {why}")
        numbers = [led.apply(float(value)) for value in values]
        return numbers[0] if len(numbers) == 1 else numbers

    def _item_numbers(self, values: list[float] | list[str], where: str) -> list[float] | list[str]:
        """Convert enumeration items that are given by number as text to numbers."""
        numbers = [parse_number(value) for value in values]
        if not isinstance(values[0], str) or not all(math.isfinite(one) for one in numbers):
            return values
        self.forgiven.append(f"{where}: an item of an enumeration by its number, {', '.join(map(str, values))}")
        return numbers

    def _without_brackets(self, description: FmuDescription) -> FmuDescription:
        """Remove the brackets around units of an FMU's variables, `[m]` to `m`."""
        changed = {}
        for name, variable in description.variables.items():
            unit = self._unit(variable.unit, f"{description.path}: {name}")
            if unit != variable.unit:
                read = conversion(unit, description.model.unitDefinitions)
                changed[name] = replace(variable, unit=unit, conversion=read)
        return replace(description, variables=description.variables | changed)

    def _unit(self, unit: str, where: str) -> str:
        """Remove brackets around a unit, which no standard allows, if lenient."""
        if not (self._lenient and unit.startswith("[") and unit.endswith("]")):
            return unit
        self.forgiven.append(f"{where}: the unit '{unit}' taken as '{unit[1:-1]}'")
        return unit[1:-1]

    def _hops(self, hops: Iterable[UnitStep], where: str) -> list[UnitStep]:
        return [hop._replace(unit=self._unit(hop.unit, where)) for hop in hops]

    def _connector(self, path: str, name: str) -> Connector | None:
        found = self._flat.components[path].connector_of.get(name)
        if found is None:
            return None
        return replace(found, unit=self._unit(found.unit, f"{self._package.file}: connector {path}.{name}"))

    def _variable(self, path: str, name: str, causes: Sequence[str], what: str) -> Variable:
        description = self._descriptions[path]
        variable = description.variables.get(name)
        where = f"{self._package.file}: a connection with {path}.{name}"
        if variable is None:
            hint = nearest(name, [v.name for v in description.variables.values() if v.causality in causes])
            raise InputRefused(f"{where}: {description.path.name} has no such variable; {hint}")
        if variable.causality not in causes:
            raise InputRefused(f"{where}: it is {variable.causality}; a connection {what}")
        if variable.kind < 0:
            raise InputRefused(f"{where}: of type {variable.type}; numbers and truth values can be connected here")
        return variable

    def _match_patterns(self, patterns: Sequence[str]) -> dict[str, list[Variable]] | None:
        """Return the variables to record, matched by the user's patterns, by component; None without patterns."""
        if not patterns:
            return None
        alone = self._package.form == SINGLE_FORM
        variables = {
            v.name if alone else f"{path}.{v.name}": (path, v)
            for path, description in self._descriptions.items()
            for v in description.variables.values()
            if v.kind >= 0
        }
        found: dict[str, None] = {}
        for pattern in patterns:
            names = match_names(pattern, variables)
            if not names:
                hint = (
                    nearest(pattern, variables)
                    if len(variables) < MAX_HINT_NAMES
                    else "see twin drive info for their names"
                )
                raise InputRefused(f"--record {pattern}: no variable of {self._package.file.name} is called so; {hint}")
            found |= dict.fromkeys(names)
        return {
            path: [v for name, (its, v) in variables.items() if its == path and name in found]
            for path in self._descriptions
        }

    def _output_ports(
        self, path: str, sources: Mapping[str, None], chosen: Mapping[str, list[Variable]] | None
    ) -> tuple[FmuPort, ...]:
        """Return the output ports of an FMU: its outputs or the `chosen` variables, then further connected ones."""
        begun = [self._variable(path, name, ("output", "local"), "begins at an output") for name in sources]
        offered = self._descriptions[path].variables_of("output") if chosen is None else list(chosen[path])
        self._recorded[path] = len(offered)
        offered += [variable for variable in begun if variable not in offered]
        if chosen is None:
            self._recorded[path] = len(offered)
        # adding -0.0 leaves every value unchanged, adding 0.0 would turn -0.0 into 0.0
        return tuple(distinct_ports([FmuPort(port_of(v, path), v, 1.0, -0.0) for v in offered]))

    def _feed_port(self, feed: Feed) -> FmuPort:
        path, name = feed.end
        end = self._variable(path, name, ("input",), "ends at an input")
        if end.size != feed.size:
            raise InputRefused(f"{feed.by}: {feed.size} values into {path}.{name}, which has {end.size}")
        for source, port in self._into[path]:
            if port.variable == end:
                others = (one.by for one in self._beside.feeds if one.source == source)
                by = next(others, "") if isinstance(source, str) else f"the connection from {'.'.join(source)}"
                raise InputRefused(f"{feed.by}: {path}.{name} is fed already, by {by}; remove one of both")
        description = self._descriptions[path]
        own = unit_of_variable(end.unit, self._connector(path, name), self._units, description, feed.by)
        other = feed.unit and feed.unit != own.text
        start = parse_unit(feed.unit, self._units, description) if other else own
        led = connection_map(start, self._hops(feed.hops or (UnitStep(),), feed.by), own, self._units, feed.by)
        return FmuPort(port_of(end, path), end, led.gain, led.shift)

    def _lead_port(self, lead: Lead) -> FmuPort:
        end = self._variable(*lead.end, ("input",), "ends at an input")
        start = self._variable(*lead.start, ("output", "local"), "begins at an output")
        where = f"{self._package.file}: the connection from {'.'.join(lead.start)} to {'.'.join(lead.end)}"
        if start.size != end.size:
            raise InputRefused(f"{where}: {start.size} values into {end.size}")
        measures = [
            unit_of_variable(v.unit, self._connector(*at), self._units, self._descriptions[at.element], where)
            for v, at in ((start, lead.start), (end, lead.end))
        ]
        led = connection_map(measures[0], self._hops(lead.hops, where), measures[1], self._units, where)
        ranks = [type_rank(variable) for variable in (start, end)]
        if ranks[0] > ranks[1] or (ranks[1] < 2 and led != (1.0, 0.0)):
            raise InputRefused(f"{where}: a {start.type} into a {end.type}; expected the same type, or a Real input")
        return FmuPort(port_of(end, lead.end.element), end, led.gain, led.shift)
