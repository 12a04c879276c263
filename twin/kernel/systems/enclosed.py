"""Enclosed systems: an SSP archive in the place of one FMU, with its connectors as variables."""

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from twin.kernel.cosim.component import Component
from twin.kernel.cosim.subsystem import INLET_NAME, Subsystem
from twin.kernel.errors import InputRefused
from twin.kernel.fmi.component import FmuComponent
from twin.kernel.fmi.description import FmuDescription
from twin.kernel.fmi.stepping import FmuPort
from twin.kernel.fmi.variable import Setting, Value, Variable, to_json
from twin.kernel.ssp.flat import FlatSystem, UnitStep, flatten
from twin.kernel.ssp.package import Package, read_package
from twin.kernel.ssp.structure import Endpoint
from twin.kernel.systems.additions import SystemNames, setting_text, with_settings
from twin.kernel.systems.choice import MasterChoice
from twin.kernel.systems.coupling import folders_of, initialise_fmus, refuse_steps
from twin.kernel.systems.extras import Feed, SystemExtras
from twin.kernel.systems.loops import find_loops
from twin.kernel.systems.opening import extract_fmus, scratch_folder
from twin.kernel.systems.plan import SystemPart, SystemPlan, plan_system
from twin.kernel.systems.timing import Timing, timing_inside
from twin.kernel.systems.unit_conversion import AffineMap, ParsedUnit, connection_map, parse_unit, unit_of_variable

OUTLET_NAME = "outlet"
_NO_TIMING = Timing(math.nan, "", 0, 0, "", {})
Start = float | np.ndarray
Ends = tuple[tuple[Endpoint, tuple[UnitStep, ...]], ...]


class EnclosedComponent(Subsystem):
    """A component that runs an SSP system of FMUs in place of one FMU."""

    def zero(self, name: str) -> float:
        """Return the value of output port `name` that corresponds to an output of 0 of the inner FMU."""
        part, _, port = self.outlets[name].rpartition(".")
        inside = next(one for one in self.system.components if one.name == part)
        assert isinstance(inside, FmuComponent)
        return inside.zero(port)


@dataclass(frozen=True)
class EnclosedSystem:
    """An SSP system (archive and its digest) that can replace an FMU, checked as far as possible without a binary.

    `variables` are connectors, and inner variables requested by name; all inner inputs or outputs if it has no
    connectors of that side. The inputs of the inner system `plan` come from the component INLET_NAME.
    """

    path: Path
    sha256: str
    version: str
    name: str
    variables: dict[str, Variable]
    plan: SystemPlan
    _flat: FlatSystem
    _exits: Mapping[str, tuple[Endpoint, AffineMap]]
    _folders: Mapping[str, Path]

    tolerance = None
    """Solver tolerance; each FMU has its own."""

    @property
    def descriptions(self) -> dict[str, FmuDescription]:
        """Descriptions of the system's FMUs by component path."""
        return {part.path: part.description for part in self.plan.parts}

    @property
    def values(self) -> dict[str, Sequence[Setting]]:
        """Values set in the inner FMUs before initialisation, by component path."""
        return {part.path: part.settings for part in self.plan.parts}

    @property
    def links(self) -> tuple[tuple[str, str], ...]:
        """Connections inside the system (output, input), "component.variable" each."""
        return tuple((".".join(lead.start), ".".join(lead.end)) for lead in self._flat.leads)

    def folder(self, part: str) -> Path:
        return self._folders[self.descriptions[part].sha256]

    def variables_of(self, causality: str) -> list[Variable]:
        """Return the system's externally visible variables of a causality, such as "input"."""
        return [v for v in self.variables.values() if v.causality == causality]

    @property
    def contents(self) -> dict[str, Any]:
        """Description of the system's FMUs, values and connections for the header of a recording."""
        return {
            "components": {
                part.path: {
                    "file": part.description.path.name,
                    "sha256": part.description.sha256,
                    "model": part.description.model.modelName,
                    "fmi": part.description.model.fmiVersion,
                    "kind": part.description.kind,
                    "set": {variable.name: to_json(value) for variable, value in part.settings},
                }
                for part in self.plan.parts
            },
            "connections": [f"{start} -> {end}" for start, end in self.links],
            "not_fed": [f"{part.path}.{v.name}" for part in self.plan.parts for v in part.unfed],
            "loops": [one.path for one in find_loops(self.plan)],
        }

    def component(
        self,
        name: str,
        inputs: Sequence[FmuPort],
        outputs: Sequence[FmuPort],
        tick: float,
        every: int = 1,
        ticks: int = 0,
        sampled: bool = False,
        inputs_at_start: Mapping[str, Start] = MappingProxyType({}),
        outputs_at_start: Mapping[str, Start] = MappingProxyType({}),
    ) -> EnclosedComponent:
        """Initialise the enclosed system as a component that makes `every` ticks (of `tick` s) in a step.

        The run takes `ticks`, 0 if unknown. Inputs without a port keep their start values; else as `FmuComponent`.
        """
        when = timing_inside(self.plan.package, self._flat, self.descriptions, tick, every, ticks)
        names = list(self.variables)
        fed = {f"{INLET_NAME}.{names.index(p.variable.name)}": (f"in{n}", p) for n, p in enumerate(inputs)}
        read = [(f"out{n}", port, *self._exits[port.variable.name]) for n, port in enumerate(outputs)]
        outside = (f"{INLET_NAME}.", f"{OUTLET_NAME}.")
        wires = [
            (f"{INLET_NAME}.{fed[source][0]}" if source in fed else source, target)
            for source, target in self.plan.wires
            if not target.startswith(outside) and (source in fed or not source.startswith(outside))
        ]
        parts = tuple(self._part(part, fed, read, wires) for part in self.plan.parts)
        plan = replace(self.plan, parts=parts, wires=tuple(wires), timing=when)
        refuse_steps(plan, "the step of the archive or of the experiment")
        given = {
            f"{INLET_NAME}.{entry}": np.broadcast_to(inputs_at_start.get(port.port.name, 0.0), port.port.size)
            for entry, port in fed.values()
        }
        owners = {part.path: part.name for part in parts}
        starts: dict[str, dict[str, Start]] = {}
        for own, port, begin, _ in read:
            if port.port.name in outputs_at_start:
                starts.setdefault(owners[begin.element], {})[own] = outputs_at_start[port.port.name]
        with ExitStack() as made:
            _, inside, *_ = initialise_fmus(plan, self._folders, made, given, outputs_at_start=starts)
            component = EnclosedComponent(
                name,
                tuple(replace(port.port, name=entry) for entry, port in fed.values()),
                [(port.port, f"{owners[end.element]}.{own}") for own, port, end, _ in read],
                list(inside.values()),
                wires,
                tick,
                every,
                plan.scheme,
                self.path.name,
                sampled,
            )
            made.pop_all()
        component.inputs = tuple(port.port for port in inputs)
        return component

    def _part(
        self,
        part: SystemPart,
        fed: Mapping[str, tuple[str, FmuPort]],
        read: Sequence[tuple[str, FmuPort, Endpoint, AffineMap]],
        wires: Collection[tuple[str, str]],
    ) -> SystemPart:
        """Scale the inputs of an inner FMU for the ports of the whole system, and keep only outputs that are read."""
        sources = {target: source for source, target in self.plan.wires}
        there, begun = {target for _, target in wires}, {source for source, _ in wires}
        inputs = []
        for port in part.inputs:
            end = f"{part.name}.{port.port.name}"
            if end in there and (source := sources[end]) in fed:
                _, outer = fed[source]
                gain, offset = outer.gain * port.gain, outer.gain * port.offset + outer.offset
                inputs.append(replace(port, gain=gain, offset=offset))
            elif end in there:
                inputs.append(port)
        outputs = [port for port in part.outputs if f"{part.name}.{port.port.name}" in begun]
        for own, port, begin, led in read:
            if begin.element == part.path:
                gain = port.gain / led.gain
                inner = part.description.variables[begin.connector]
                named = replace(port.port, name=own)
                outputs.append(FmuPort(named, inner, gain, port.offset - gain * led.shift))
        return replace(part, inputs=tuple(inputs), outputs=tuple(outputs), recorded=len(outputs))


def enclose_system(file: Path, table: str, values: Mapping[str, Value], named: Collection[str]) -> EnclosedSystem:
    """Read an SSP archive as a system that replaces an FMU, named in the experiment's `table`.

    `values` are start values, also of inputs that then have no source, by "component.variable" or connector; `named`
    the names that the mapping uses, possibly of inner variables.
    """
    package = read_package(file)
    flat = flatten(package.structure, f"{file}")
    with scratch_folder(package) as scratch:
        files, names = extract_fmus(package, flat, Path(scratch))
        settings = [f"{name}={setting_text(value)}" for name, value in values.items()]
        flat = with_settings(flat, names, settings, f"[{table}.parameters]")
        face = _OuterVariables(package, flat, names, values, named)
        place = Component(INLET_NAME, (), (), True, 0, 0, np.zeros(0))
        beside = SystemExtras((place,), tuple(face.feeds()), tuple(face.drains()))
        plan = plan_system(package, flat, files, MasterChoice(), beside, when=_NO_TIMING)
        folders = folders_of(plan)
    # paths inside the archive, as the extracted files are deleted
    parts = tuple(
        replace(part, description=replace(part.description, path=file / part.description.path.relative_to(scratch)))
        for part in plan.parts
    )
    system = package.structure.system.name
    return EnclosedSystem(
        file, package.sha256, package.structure.version, system, face.variables, replace(plan, parts=parts),
        flat, face.exits, folders,
    )  # fmt: skip


class _OuterVariables:
    """Variables of a system visible from outside; `exits`: visible output -> inner variable, conversion from it."""

    def __init__(
        self,
        package: Package,
        flat: FlatSystem,
        names: SystemNames,
        values: Mapping[str, Value],
        named: Collection[str],
    ):
        self._package, self._flat, self._names, self._values = package, flat, names, values
        self.variables: dict[str, Variable] = {}
        self.exits: dict[str, tuple[Endpoint, AffineMap]] = {}
        self._ends: dict[str, Ends] = {}
        self._units: dict[str, str] = {}
        for name, ends in flat.entrances.items():
            if ends:
                self._add_input(name, ends)
        for name, lead in flat.exits.items():
            self._add_output(name, lead.start, lead.hops)
        asked = {name.removeprefix("-").strip() for name in named}
        for name in package.structure.system.connector_of.keys() & asked - self.variables.keys():
            raise InputRefused(
                f"{package.file}: its connector '{name}' leads to no component; connect it in the archive"
            )
        self._add_inner_variables(asked)

    def _add_inner_variables(self, asked: Collection[str]) -> None:
        """Add requested inner variables to the visible ones; for a side without connectors, all inputs or outputs."""
        fed = {lead.end for lead in self._flat.leads}
        for path in self._flat.components:
            given = self._flat.assigned.get(path, {})
            for variable in self._names.description(path).variables.values():
                name, end = f"{path}.{variable.name}", Endpoint(path, variable.name)
                if variable.kind < 0 or name in self.variables:
                    continue
                if variable.causality == "input" and end not in fed:
                    if name in asked or (not self._flat.entrances and variable.name not in given):
                        self._add_input(name, ((end, ()),))
                elif (variable.causality == "output" and not self._flat.exits) or name in asked:
                    self._add_output(name, end, ())

    def feeds(self) -> Iterator[Feed]:
        """Yield the connections to inputs of inner components, except of inputs with fixed values."""
        for number, (name, variable) in enumerate(self.variables.items()):
            for end, hops in self._ends.get(name, ()) if name not in self._values else ():
                by = f"{self._package.file}: {name}"
                yield Feed(end, f"{INLET_NAME}.{number}", by, self._units[name], hops, variable.size)

    def drains(self) -> Iterator[tuple[Endpoint, str]]:
        for number, name in enumerate(self.variables):
            if name in self.exits:
                yield self.exits[name][0], f"{OUTLET_NAME}.{number}"

    def _variable_unit(self, end: Endpoint) -> ParsedUnit:
        description, where = self._names.description(end.element), f"{self._package.file}: {'.'.join(end)}"
        connector = self._flat.components[end.element].connector_of.get(end.connector)
        return unit_of_variable(
            self._names.variable(end).unit, connector, self._package.structure.units, description, where
        )

    def _connector_unit(self, name: str, end: Endpoint) -> ParsedUnit:
        """Look up the unit that a connector declares, in the archive, then in the FMU behind it; "" if undeclared."""
        connector = self._package.structure.system.connector_of.get(name)
        units, description = self._package.structure.units, self._names.description(end.element)
        return parse_unit(connector.unit if connector else "", units, description)

    def _add_input(self, name: str, ends: Ends) -> None:
        inner = [self._inner_variable(end, ("input",), name) for end, _ in ends]
        measured = [self._variable_unit(end) for end, _ in ends]
        stated = self._connector_unit(name, ends[0][0])
        if not stated.text and len({one.conversion for one in measured}) > 1:
            units = ", ".join(f"{'.'.join(end)} [{one.text}]" for (end, _), one in zip(ends, measured, strict=True))
            raise InputRefused(f"{self._package.file}: connector '{name}' feeds {units}; state its unit")
        self._ends[name], self._units[name] = ends, stated.text
        self._add_variable(name, "input", inner[0], stated if stated.text else measured[0])

    def _add_output(self, name: str, start: Endpoint, hops: tuple[UnitStep, ...]) -> None:
        inner, measured = self._inner_variable(start, ("output", "local"), name), self._variable_unit(start)
        stated = self._connector_unit(name, start)
        there = stated if stated.text else measured
        where = f"{self._package.file}: connector '{name}'"
        self.exits[name] = start, connection_map(measured, hops, there, self._package.structure.units, where)
        self._add_variable(name, "output", inner, there)

    def _inner_variable(self, end: Endpoint, causes: Sequence[str], name: str) -> Variable:
        found = self._names.description(end.element).variables.get(end.connector)
        if found is None or found.causality not in causes or found.kind < 0:
            what = "no such variable" if found is None else f"{found.causality} {found.type}"
            raise InputRefused(
                f"{self._package.file}: connector '{name}' leads to {'.'.join(end)}, which is {what}; expected a "
                f"number that is {' or '.join(causes)}"
            )
        return found

    def _add_variable(self, name: str, causality: str, inner: Variable, unit: ParsedUnit) -> None:
        changed = replace(inner, name=name, causality=causality, unit=unit.text, conversion=unit.conversion)
        self.variables[name] = replace(changed, start=math.nan, low=math.nan, high=math.nan)
