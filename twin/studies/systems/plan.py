"""The plan of an SSP system: FMUs checked, connections and values converted; nothing is loaded.

Variables of FMUs as ports of components.

What components and variables of a system are called in the master and in a recording, where names are words.

How long a system is run, and in which steps.

What becomes of a value on its way from one variable to another: units converted, lines applied.
"""

import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

from twin.kernel.cosim.interpolation import Scheme
from twin.kernel.cosim.port import Port
from twin.kernel.errors import InputRefused, nearest
from twin.kernel.files import xml_of
from twin.kernel.fmi.description import FmuDescription, described, stated_step
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


MOST_TICKS = 1e12
STEPS = ("stepSize", "baseStepSize")
"""What OMSimulator and libcosim call the length of a step in annotations."""


class Timing(NamedTuple):
    """Length of a step (s), who says so, and how many there are."""

    tick: float
    source: str
    ticks: int


def timing(
    package: Package, descriptions: Mapping[str, FmuDescription], tick: float | None, stop: float | None
) -> Timing:
    """As the system of an archive says.

    Args:
        package: of the system.
        descriptions: of the FMUs, by component.
        tick: length of a step (s) that the user asks for; None: not given.
        stop: end of the run (s), likewise.

    Raises:
        InputRefused: it is not stated, the run would not begin at 0, or not end with a step.
    """
    length, source = (tick, "--tick-ms") if tick is not None else _stated(package, descriptions)
    experiment = package.structure.experiment
    end = experiment.stop if stop is None else stop
    if experiment.start:
        raise InputRefused(f"{package.file}: its experiment starts at {experiment.start:g} s; here runs begin at 0 s")
    if end is None:
        raise InputRefused(f"{package.file}: states no stop time (DefaultExperiment); give --stop-s")
    if not 0.0 < end / length < MOST_TICKS:
        raise InputRefused(
            f"{package.file}: {end:g} s in steps of {length:g} s; expected at least one step, and fewer than "
            f"{MOST_TICKS:g}"
        )
    ticks = round(end / length)
    if ticks < 1 or abs(ticks * length - end) > 1e-6 * length:
        raise InputRefused(
            f"{package.file}: {end:g} s is not a whole number of steps of {1e3 * length:g} ms; "
            "set --stop-s or --tick-ms"
        )
    return Timing(length, source, ticks)


def _stated(package: Package, descriptions: Mapping[str, FmuDescription]) -> tuple[float, str]:
    """The length of a step (s), and who says so: a tool in the structure, else the FMU that wants the shortest."""
    structure = package.structure
    for note in (*structure.experiment.annotations, *structure.system.annotations, *structure.annotations):
        where = f"{package.file}: annotation {note.type}"
        for element in xml_of(note.content.encode(), where).iter() if note.content else ():
            for name in STEPS:
                if 0.0 < (step := number(element.get(name))) < math.inf:
                    return step, f"an annotation of the structure ({note.type})"
    steps = {path: step for path, one in descriptions.items() if 0.0 < (step := stated_step(one)) < math.inf}
    if not steps:
        raise InputRefused(f"{package.file}: neither the structure nor an FMU states a step size; give --tick-ms")
    shortest = min(steps, key=lambda path: steps[path])
    return steps[shortest], f"what the FMU of {shortest} wants{'' if len(steps) == 1 else ', the shortest'}"


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
        parts: in the order of the file.
        wires: (output, input) of the master, "part.port" each.
        timing: of the run.
        scheme: of the coupling.
        ignored: names that get values, and nothing is called so.
    """

    package: Package
    parts: tuple[SystemPart, ...]
    wires: tuple[tuple[str, str], ...]
    timing: Timing
    scheme: Scheme
    ignored: tuple[str, ...]

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
        if component.implementation not in ("any", "CoSimulation"):
            raise InputRefused(
                f"{where} is to be used for {component.implementation}, which is not supported; expected an FMU for "
                "co-simulation"
            )
        found[path] = package.entry(component.source)
        if not found[path]:
            raise InputRefused(f"{where}: its resource '{component.source}' is no file of this archive")
    return found


def planned(
    package: Package,
    flat: FlatSystem,
    files: Mapping[str, Path],
    tick: float | None,
    stop: float | None,
    scheme: Scheme,
) -> SystemPlan:
    """The plan of a system.

    Args:
        package: of the system.
        flat: the system.
        files: of the FMUs, by entry.
        tick: length of a step (s); None: as the system says.
        stop: end of the run (s); None: likewise.
        scheme: of the coupling.

    Raises:
        InputRefused: an FMU that cannot be used, a connection that cannot be made, a value that cannot be set, an
            input that has no value, or the length of a step or of the run is not stated.
    """
    reader = _Planner(package, flat, files)
    parts = tuple(reader.part(path) for path in flat.components)
    if not any(part.outputs for part in parts):
        raise InputRefused(f"{package.file}: no FMU has an output that is a number; there is nothing to record")
    when = timing(package, {part.path: part.description for part in parts}, tick, stop)
    ignored = (*flat.ignored, *reader.ignored)
    return SystemPlan(package, parts, tuple(reader.wires()), when, scheme, ignored)


class _Planner:
    """Makes parts, and remembers what wires need.

    Attributes:
        ignored: names of variables that get values and that their FMU has not.
    """

    def __init__(self, package: Package, flat: FlatSystem, files: Mapping[str, Path]):
        self._package, self._flat, self._units = package, flat, package.structure.units
        self.ignored: list[str] = []
        self._descriptions: dict[str, FmuDescription] = {}
        self._given: dict[str, dict[str, Value]] = {}
        # /events is in every recording
        names = distinct([EVENTS, *(topic(path) for path in flat.components)])[1:]
        self._names = dict(zip(flat.components, names, strict=True))
        for path, entry in fmu_sources(package, flat).items():
            plain = described(files[entry])
            if plain.kind != "co_simulation":
                raise InputRefused(f"{files[entry]}: offers model exchange alone; export it for co-simulation")
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
        if isinstance(values[0], str):
            if any(hop.transformation.table for hop in assigned.hops):
                raise InputRefused(f"{where}: a transformation of text, which is not supported")
            return values[0] if len(values) == 1 else [str(value) for value in values]
        own = measure(variable.unit, self._connector(path, variable.name), self._units, description, where)
        start = spelt(assigned.value.unit, (*assigned.units, *self._units))
        if start.text and start.conversion is None:
            start = SpeltUnit(start.text, conversion(start.text, description.model.unitDefinitions))
        led = way(start, assigned.hops or (Hop(),), own, self._units, where)
        numbers = [led.end(float(value)) for value in values]
        return numbers[0] if len(numbers) == 1 else numbers

    def _connector(self, path: str, name: str) -> Connector | None:
        return self._flat.components[path].connector_of.get(name)

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
        led = way(measures[0], lead.hops, measures[1], self._units, where)
        ranks = [rank(variable) for variable in (start, end)]
        if ranks[0] > ranks[1] or (ranks[1] < 2 and led != (1.0, 0.0)):
            raise InputRefused(f"{where}: a {start.type} into a {end.type}; expected the same type, or a Real input")
        return FmuPort(port_of(end, lead.end.element), end, led.gain, led.shift)
