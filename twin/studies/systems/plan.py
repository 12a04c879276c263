"""The plan of an SSP system: FMUs checked, connections and values converted; nothing is loaded.

Variables of FMUs as ports of components.

What components and variables of a system are called in the master and in a recording, where names are words.

What becomes of a value on its way from one variable to another: units converted, lines applied.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from twin.kernel.cosim.adaptive import NAME as MASTER
from twin.kernel.cosim.interpolation import Scheme
from twin.kernel.cosim.port import Port
from twin.kernel.errors import InputRefused, nearest
from twin.kernel.fmi.description import KIND_NAMES, FmuDescription, Kind, described
from twin.kernel.fmi.stepping import FmuPort
from twin.kernel.fmi.variable import (
    Conversion,
    Setting,
    Value,
    Variable,
    conversion,
    given_values,
    meant,
    number,
    set_to,
    stated_unit,
)
from twin.kernel.recording.writer import EVENTS
from twin.kernel.ssp.flat import Assigned, FlatSystem, Hop, Lead
from twin.kernel.ssp.ssd import Package
from twin.kernel.ssp.structure import FMU, Connector, UnitDefinition
from twin.studies.systems.choice import MasterChoice
from twin.studies.systems.timing import Timing, ordered, timing

_ELEMENT = re.compile(r"(.+)\[(\d+)\]")


def word(name: str) -> str:
    """`name` with letters, digits and underscores alone, a letter first."""
    text = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "x"
    return text if text[0].isalpha() else f"x_{text}"


def distinct(names: Iterable[str]) -> list[str]:
    """`names`, those that have come before with a number."""
    seen: set[str] = set()
    found = []
    for name in names:
        number = 1
        while (one := name if number == 1 else f"{name}_{number}") in seen:
            number += 1
        seen.add(one)
        found.append(one)
    return found


def topic(path: str) -> str:
    """Of a component: `arm/motor` of `arm.motor`."""
    return "/".join(word(part) for part in path.split("."))


def field(variable: str, path: str) -> str:
    """Of a variable of the component at `path`, whose own name in front of it is left out: `p_B` of `plant.p_B`."""
    return word(variable.removeprefix(f"{path.rpartition('.')[2]}."))


def element(variable: str) -> tuple[str, int]:
    """(array, number) of a variable that is an element of one, `p_B[2]`; number 0: it is none."""
    match = _ELEMENT.fullmatch(variable)
    return (match[1], int(match[2])) if match else (variable, 0)


KINDS = {"Real": "double", "Float64": "double", "Float32": "double", "Boolean": "bool"}
"""Of a recording, by the type of a variable; whole numbers are all others."""


def rank(variable: Variable) -> int:
    """Of its type: 2 real, 1 whole, 0 truth value; a value goes into what has as much room."""
    return {"double": 2, "bool": 0}.get(KINDS.get(variable.type, "int"), 1)


def port_of(variable: Variable, path: str) -> Port:
    """The port of a variable of the component at `path`."""
    kind = KINDS.get(variable.type, "int")
    meaning = f"{variable.name}: {variable.description}" if variable.description else variable.name
    return Port(field(variable.name, path), variable.size, variable.unit or "1", meaning, kind)  # type: ignore[arg-type]


def distinct_ports(ports: Sequence[FmuPort]) -> list[FmuPort]:
    """`ports`, each with a name of its own."""
    names = distinct(port.port.name for port in ports)
    return [replace(port, port=replace(port.port, name=name)) for port, name in zip(ports, names, strict=True)]


class SpeltUnit(NamedTuple):
    """A unit as spelt in a file, and its meaning; None: not known. No unit is spelt ""."""

    text: str
    conversion: Conversion | None


class Way(NamedTuple):
    """Value at the start = gain * value at the end + shift: the wrong way round, as FMU ports are scaled, so that a
    unit is one division, and one unit for another of the same size is nothing."""

    gain: float = 1.0
    shift: float = 0.0

    def end(self, value: float) -> float:
        """What a value at the start becomes."""
        return (value - self.shift) / self.gain

    def then(self, way: "Way") -> "Way":
        """This way, and then another one."""
        return Way(self.gain * way.gain, self.gain * way.shift + self.shift)


def measure(
    variable_unit: str,
    connector: Connector | None,
    units: Sequence[UnitDefinition],
    description: FmuDescription,
    where: str,
) -> SpeltUnit:
    """In what a variable of an FMU is, by the FMU and by the connector that stands for it.

    Raises:
        InputRefused: they say different things.
    """
    own = SpeltUnit(
        variable_unit, conversion(variable_unit, description.model.unitDefinitions) if variable_unit else None
    )
    if connector is None or not connector.unit or connector.unit == variable_unit:
        return own
    read = spelt(connector.unit, units)
    if own.text and read.conversion != own.conversion:
        raise InputRefused(
            f"{where}: {connector.name} is in '{connector.unit}' by its connector, and in '{own.text}' by the FMU; "
            "correct the connector"
        )
    return read


def spelt(text: str, units: Sequence[UnitDefinition]) -> SpeltUnit:
    """A unit by what an SSP file defines, or else by what all know."""
    return SpeltUnit(text, (stated_unit(text, units) or meant(text)) if text else None)


def way(start: SpeltUnit, hops: Iterable[Hop], end: SpeltUnit, units: Sequence[UnitDefinition], where: str) -> Way:
    """The whole way of a value.

    Args:
        start: of what it leaves.
        hops: its parts.
        end: of where it gets.
        units: that the structure defines, for connectors of systems on the way.
        where: for sentences.

    Raises:
        InputRefused: units on it measure different things, or one is not known; a factor is 0, or all together beyond
            numbers; a transformation is no line.
    """
    found, here, hops = Way(), start, list(hops)
    for count, (transformation, suppressed, unit) in enumerate(hops, start=1):
        last = count == len(hops)
        there = end if last else spelt(unit, units) if unit else here
        if not suppressed:
            found = found.then(_between(here, there, where))
        if transformation.table:
            raise InputRefused(f"{where}: {transformation.table} is not supported; a LinearTransformation is")
        if transformation.factor == 0.0:
            raise InputRefused(f"{where}: the factor 0; leave the connection out, and give the input a start value")
        factor, offset = transformation.factor, transformation.offset
        if (factor, offset) != (1.0, 0.0):
            found = found.then(Way(1.0 / factor, -offset / factor))
        here = there if there.text else here
    if not (0.0 < abs(found.gain) < math.inf and math.isfinite(found.shift)):
        raise InputRefused(f"{where}: the conversion factor exceeds the range of a number")
    return found


def _between(here: SpeltUnit, there: SpeltUnit, where: str) -> Way:
    if not here.text or not there.text or here.text == there.text:
        return Way()
    for one in (here, there):
        if one.conversion is None:
            raise InputRefused(f"{where}: the unit '{one.text}' is not defined; define it, with its BaseUnit")
    source, target = here.conversion, there.conversion
    assert source is not None and target is not None
    if source.dimension != target.dimension:
        raise InputRefused(f"{where}: from '{here.text}' to '{there.text}', which have different dimensions")
    return Way(target.factor / source.factor, (target.offset - source.offset) / source.factor)


KINDS_OF: Mapping[str, Kind | None] = {
    "any": None,
    "CoSimulation": "co_simulation",
    "ModelExchange": "model_exchange",
}
"""What a structure calls the kinds of FMUs."""
SETTABLE = ("parameter", "structuralParameter", "input")
STARTED = ("exact", "approx")
"""What can be set before a run: these causalities, and what has a start value of its own (SSP 1.0, 5.3.5)."""


@dataclass(frozen=True)
class SystemPart:
    """A component of the system.

    Attributes:
        path: by which the system calls it.
        name: in the master, and of its topic.
        description: of its FMU, parameters that size arrays set.
        inputs: that are fed, scaled for what feeds them.
        outputs: that are recorded, as the FMU gives them.
        settings: values of parameters and of inputs before initialisation.
        unfed: inputs without a source.
    """

    path: str
    name: str
    description: FmuDescription
    inputs: tuple[FmuPort, ...]
    outputs: tuple[FmuPort, ...]
    settings: tuple[Setting, ...]
    unfed: tuple[Variable, ...]


@dataclass(frozen=True)
class SystemPlan:
    """A system that can be made.

    Attributes:
        package: where it is from.
        parts: in the order in which they step.
        wires: (output, input) of the master, "part.port" each.
        timing: of the run.
        choice: what is asked of the master.
        ignored: names that get values, and nothing is called so.
        forgiven: offences of files that were let through.
    """

    package: Package
    parts: tuple[SystemPart, ...]
    wires: tuple[tuple[str, str], ...]
    timing: Timing
    choice: MasterChoice
    ignored: tuple[str, ...]
    forgiven: tuple[str, ...] = ()

    @property
    def scheme(self) -> Scheme:
        """Of the coupling."""
        return self.choice.scheme

    @property
    def late(self) -> list[tuple[str, str]]:
        """(output, input) of what gets values from the start of the step: in Gauss-Seidel order what leads back. Both
        as the system calls them."""
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
            if self.scheme == "jacobi" or order[source.partition(".")[0]] >= order[target.partition(".")[0]]
        ]


def fmu_sources(package: Package, flat: FlatSystem) -> dict[str, str]:
    """The entry of the archive of each component's FMU, by its path.

    Raises:
        InputRefused: there is no component, or one is something else, or not in the archive.
    """
    if not flat.components:
        raise InputRefused(f"{package.file}: a system without components; expected at least one")
    found = {}
    for path, component in flat.components.items():
        where = f"{package.file}: component '{path}'"
        if component.type not in (FMU, ""):
            raise InputRefused(f"{where} is of type {component.type}, which is not supported; expected {FMU}")
        if component.implementation not in KINDS_OF:
            raise InputRefused(
                f"{where} is to be used for {component.implementation}, which is not supported; expected an FMU for "
                "co-simulation or model exchange"
            )
        found[path] = package.entry(component.source)
        if not found[path]:
            raise InputRefused(f"{where}: its resource '{component.source}' is no file of this archive")
    return found


def planned(package: Package, flat: FlatSystem, files: Mapping[str, Path], choice: MasterChoice) -> SystemPlan:
    """The plan of a system.

    Args:
        package: of the system.
        flat: the system.
        files: of the FMUs, by entry.
        choice: what is asked of the master.

    Raises:
        InputRefused: an FMU that cannot be used, a connection that cannot be made, a value that cannot be set, an
            input that has no value, or the length of a step or of the run is not stated.
    """
    choice.refuse_unknown(flat.components, f"{package.file}")
    reader = _Planner(package, flat, files, choice)
    parts = tuple(reader.part(path) for path in ordered(package, flat, choice))
    if not any(part.outputs for part in parts):
        raise InputRefused(f"{package.file}: no FMU has an output that is a number; there is nothing to record")
    when = timing(package, flat, {part.path: part.description for part in parts}, choice)
    ignored = (*flat.ignored, *reader.ignored)
    wires = tuple(reader.wires())
    return SystemPlan(package, parts, wires, when, choice, ignored, tuple(dict.fromkeys(reader.forgiven)))


def _of_kind(file: Path, stated: str, path: str, choice: MasterChoice) -> FmuDescription:
    """The FMU of a component as what it is used: what is asked for it by name, else stated, else asked for all."""
    usual = described(file)
    named, stated_kind = choice.kinds.get(path), KINDS_OF[stated]
    kind = named or stated_kind
    if kind is None:
        # asked for all means those that can be
        every = choice.kinds.get("")
        return described(file, every) if every in usual.kinds else usual
    if kind not in usual.kinds:
        who = f"--kind {path}={kind}" if named else f"its component {path} is to be used for {KIND_NAMES[kind]}"
        raise InputRefused(f"{file}: offers {KIND_NAMES[usual.kinds[0]]} alone, and {who}; export it for that, too")
    return described(file, kind)


class _Planner:
    """Makes parts, and remembers what wires need.

    Attributes:
        ignored: names of variables that get values and that their FMU has not.
        forgiven: offences that are let through.
    """

    def __init__(self, package: Package, flat: FlatSystem, files: Mapping[str, Path], choice: MasterChoice):
        self._package, self._flat, self._units = package, flat, package.structure.units
        self.ignored: list[str] = []
        self.forgiven: list[str] = []
        self._lenient = choice.lenient
        self._descriptions: dict[str, FmuDescription] = {}
        self._given: dict[str, dict[str, Value]] = {}
        # /events is in every recording
        taken = [EVENTS, *([MASTER] if choice.tolerance is not None else [])]
        names = distinct([*taken, *(topic(path) for path in flat.components)])[len(taken) :]
        self._names = dict(zip(flat.components, names, strict=True))
        for path, entry in fmu_sources(package, flat).items():
            plain = self._unbracketed(_of_kind(files[entry], flat.components[path].implementation, path, choice))
            self._given[path] = dict(self._values(path, plain))
            self._descriptions[path] = plain.resized(
                {name: float(value) for name, value in self._given[path].items() if isinstance(value, (int, float))}
            )
        self._refuse_second_instances()
        self._leads: dict[str, list[tuple[Lead, FmuPort]]] = {path: [] for path in flat.components}
        sources: dict[str, dict[str, None]] = {path: {} for path in flat.components}
        for lead in flat.leads:
            sources[lead.start.element][lead.start.connector] = None
        self._outputs = {path: self._offered(path, sources[path]) for path in flat.components}
        for lead in flat.leads:
            self._leads[lead.end.element].append((lead, self._input(lead)))
        self._ports = {path: distinct_ports([port for _, port in self._leads[path]]) for path in self._leads}

    def part(self, path: str) -> SystemPart:
        description = self._descriptions[path]
        fed = {lead.end.connector for lead, _ in self._leads[path]}
        unfed = tuple(v for v in description.offered("input") if v.name not in fed)
        started = {v.name for v in description.model.modelVariables if v.start is not None} | set(self._given[path])
        for variable in unfed:
            if variable.name not in started:
                raise InputRefused(
                    f"{self._package.file}: input {path}.{variable.name} has no source and no start value; "
                    "connect it, or give it one in a parameter set"
                )
        settings = [
            (variable, set_to(description.path, variable, value))
            for name, value in self._given[path].items()
            if (variable := description.variables[name])
        ]
        return SystemPart(
            path, self._names[path], description, tuple(self._ports[path]), self._outputs[path], tuple(settings), unfed
        )

    def wires(self) -> Iterator[tuple[str, str]]:
        sources = {(path, p.variable.name): p for path, ports in self._outputs.items() for p in ports}
        for path, leads in self._leads.items():
            for (lead, _), port in zip(leads, self._ports[path], strict=True):
                start = lead.start.element
                source = sources[start, lead.start.connector]
                yield f"{self._names[start]}.{source.port.name}", f"{self._names[path]}.{port.port.name}"

    def _refuse_second_instances(self) -> None:
        seen: dict[str, str] = {}
        for path, description in self._descriptions.items():
            if description.lives_once and (other := seen.setdefault(description.sha256, path)) != path:
                raise InputRefused(
                    f"{description.path}: can be instantiated only once in a process "
                    f"(canBeInstantiatedOnlyOncePerProcess); the system needs it for {other} and for {path}"
                )

    def _values(self, path: str, description: FmuDescription) -> Iterator[tuple[str, Value]]:
        started = {v.name for v in description.model.modelVariables if v.initial in STARTED}
        for name, assigned in self._flat.assigned.get(path, {}).items():
            variable = description.variables.get(name)
            if variable is None:
                self.ignored.append(f"{path}.{name}")
                continue
            where = f"{self._package.file}: {path}.{name}"
            if variable.variability == "constant" or (variable.causality not in SETTABLE and name not in started):
                raise InputRefused(
                    f"{where}: cannot be set, being {variable.causality} without a start value; parameters, inputs and "
                    "start values can"
                )
            yield name, self._value(assigned, variable, description, path, where)

    def _value(
        self, assigned: Assigned, variable: Variable, description: FmuDescription, path: str, where: str
    ) -> Value:
        values = given_values(assigned.value, where)
        if self._lenient and not variable.is_text:
            values = self._counted(values, where)
        if isinstance(values[0], str):
            if any(hop.transformation.table for hop in assigned.hops):
                raise InputRefused(f"{where}: a transformation of text, which is not supported")
            return values[0] if len(values) == 1 else [str(value) for value in values]
        own = measure(variable.unit, self._connector(path, variable.name), self._units, description, where)
        start = spelt(self._unit(assigned.value.unit, where), (*assigned.units, *self._units))
        if start.text and start.conversion is None:
            start = SpeltUnit(start.text, conversion(start.text, description.model.unitDefinitions))
        led = way(start, self._hops(assigned.hops or (Hop(),), where), own, self._units, where)
        numbers = [led.end(float(value)) for value in values]
        return numbers[0] if len(numbers) == 1 else numbers

    def _counted(self, values: list[float] | list[str], where: str) -> list[float] | list[str]:
        """Items of an enumeration that are given by their numbers as text."""
        numbers = [number(value) for value in values]
        if not isinstance(values[0], str) or not all(math.isfinite(one) for one in numbers):
            return values
        self.forgiven.append(f"{where}: an item of an enumeration by its number, {', '.join(map(str, values))}")
        return numbers

    def _unbracketed(self, description: FmuDescription) -> FmuDescription:
        """The same FMU with its variables in units without brackets."""
        changed = {}
        for name, variable in description.variables.items():
            unit = self._unit(variable.unit, f"{description.path}: {name}")
            if unit != variable.unit:
                read = conversion(unit, description.model.unitDefinitions)
                changed[name] = replace(variable, unit=unit, conversion=read)
        return replace(description, variables=description.variables | changed)

    def _unit(self, unit: str, where: str) -> str:
        """A unit without brackets around it, which no standard knows."""
        if not (self._lenient and unit.startswith("[") and unit.endswith("]")):
            return unit
        self.forgiven.append(f"{where}: the unit '{unit}' taken as '{unit[1:-1]}'")
        return unit[1:-1]

    def _hops(self, hops: Iterable[Hop], where: str) -> list[Hop]:
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

    def _offered(self, path: str, sources: Mapping[str, None]) -> tuple[FmuPort, ...]:
        """Outputs of the FMU, and what else connections begin at."""
        description = self._descriptions[path]
        begun = [self._variable(path, name, ("output", "local"), "begins at an output") for name in sources]
        offered = description.offered("output")
        offered += [variable for variable in begun if variable not in offered]
        # what -0.0 is added to stays what it is
        return tuple(distinct_ports([FmuPort(port_of(v, path), v, 1.0, -0.0) for v in offered]))

    def _input(self, lead: Lead) -> FmuPort:
        end = self._variable(*lead.end, ("input",), "ends at an input")
        start = self._variable(*lead.start, ("output", "local"), "begins at an output")
        where = f"{self._package.file}: the connection from {'.'.join(lead.start)} to {'.'.join(lead.end)}"
        if start.size != end.size:
            raise InputRefused(f"{where}: {start.size} values into {end.size}")
        measures = [
            measure(v.unit, self._connector(*at), self._units, self._descriptions[at.element], where)
            for v, at in ((start, lead.start), (end, lead.end))
        ]
        led = way(measures[0], self._hops(lead.hops, where), measures[1], self._units, where)
        ranks = [rank(variable) for variable in (start, end)]
        if ranks[0] > ranks[1] or (ranks[1] < 2 and led != (1.0, 0.0)):
            raise InputRefused(f"{where}: a {start.type} into a {end.type}; expected the same type, or a Real input")
        return FmuPort(port_of(end, lead.end.element), end, led.gain, led.shift)
