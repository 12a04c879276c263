"""Values that a user adds to a system, singly or by SSV files, and lookup of names in a system."""

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path

import numpy as np

from twin.kernel.errors import InputRefused, nearest
from twin.kernel.files import read_bytes
from twin.kernel.fmi.description import FmuDescription, described
from twin.kernel.fmi.variable import MAX_EXACT, Value, Variable
from twin.kernel.ssp import structure as ssp
from twin.kernel.ssp.flat import AssignedValue, FlatSystem
from twin.kernel.ssp.package import Package
from twin.kernel.ssp.ssd import parameter_set
from twin.kernel.systems.naming import SINGLE_FORM
from twin.kernel.units import parse_float

UNIT_PATTERN = re.compile(r"(?P<value>.*\S)\s*\[(?P<unit>[^\[\]]*)\]")
_LIST_PATTERN = re.compile(r"\[(?P<values>.*)\]")


@dataclass(frozen=True)
class Additions:
    """Changes to a system given on the command line: texts NAME=VALUE, SSV files, inputs over time, signals to record.

    Inputs are NAME=SOURCE, or files whose columns have the names of inputs. Later SSV files take precedence, and
    settings over all files. Signals are recorded by name patterns; all outputs without patterns.
    """

    settings: Sequence[str] = ()
    parameters: Sequence[Path] = ()
    inputs: Sequence[str] = ()
    recorded: Sequence[str] = ()


def setting_text(value: Value) -> str:
    """Format a value of a setting as text that parses to the same value."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, str):
        return value
    if isinstance(value, Sequence | np.ndarray):
        return f"[{', '.join(setting_text(one) for one in value)}]"
    return str(value) if isinstance(value, int | np.integer) else repr(float(value))


def with_parameters(package: Package, files: Sequence[Path]) -> Package:
    """Add the values of SSV files to the outermost system of an SSP package."""
    if not files:
        return package
    sets = [parameter_set(read_bytes(file, kind="SSV file"), str(file), str(file)) for file in files]
    if package.form == SINGLE_FORM:
        # for a single FMU, the component name may be omitted
        before = f"{package.structure.system.elements[0].name}."
        sets = [
            replace(
                one, parameters=tuple(replace(v, name=before + v.name.removeprefix(before)) for v in one.parameters)
            )
            for one in sets
        ]
    system = package.structure.system
    bindings = (*system.bindings, *(ssp.ParameterBinding(one) for one in sets))
    return replace(package, structure=replace(package.structure, system=replace(system, bindings=bindings)))


class SystemNames:
    """Lookup of component and variable names in a system, whose components have the FMU `files`."""

    def __init__(self, package: Package, flat: FlatSystem, files: Mapping[str, Path]):
        self.package, self.flat = package, flat
        self.alone = next(iter(files)) if package.form == SINGLE_FORM else ""
        self._files = files

    def description(self, path: str) -> FmuDescription:
        # lenient: the plan checks whether the FMU needs its authoring tool
        return described(self._files[path], lenient=True)

    def place(self, name: str, option: str) -> ssp.Endpoint:
        """Return the (component, variable) called `name`; component "" for a connector of the outermost system."""
        if name in self.package.structure.system.connector_of:
            return ssp.Endpoint("", name)
        owners = [path for path in self._files if name.startswith(f"{path}.")]
        path = max(owners, key=len, default=self.alone)
        variable = name.removeprefix(f"{path}.")
        if path and variable in self.description(path).variables:
            return ssp.Endpoint(path, variable)
        where = f"{option} {name}: {self.package.file.name}"
        if path:
            description = self.description(path)
            known = [v.name for v in (*description.parameters, *description.variables_of("input"))]
            hint = "it can be set: {}" if len(known) < 20 else "see twin drive info for its names"
            raise InputRefused(f"{where}: {path} has no variable '{variable}'; {nearest(variable, known, hint)}")
        raise InputRefused(f"{where} has no component of this name; {nearest(name.partition('.')[0], self._files)}")

    def variable(self, end: ssp.Endpoint) -> Variable:
        return self.description(end.element).variables[end.connector]

    def inputs(self) -> Iterator[tuple[str, ssp.Endpoint]]:
        """Yield (name, endpoint) of every system input that a column of a file may feed."""
        for name in self.flat.entrances:
            yield name, ssp.Endpoint("", name)
        for path in self._files:
            for variable in self.description(path).variables_of("input"):
                yield f"{path}.{variable.name}", ssp.Endpoint(path, variable.name)
                if self.alone:
                    yield variable.name, ssp.Endpoint(path, variable.name)


def with_settings(flat: FlatSystem, names: SystemNames, settings: Sequence[str], where: str = "--set") -> FlatSystem:
    """Add the values of settings NAME=VALUE to the outermost system of a package; they override all others.

    Error messages begin with `where`, which names the option or table of the settings.
    """
    assigned = {path: dict(values) for path, values in flat.assigned.items()}
    seen: dict[ssp.Endpoint, str] = {}
    for text in settings:
        name, equals, given = (part.strip() for part in text.partition("="))
        if not equals or not name or not given:
            raise InputRefused(f"{where} {text}: expected NAME=VALUE, such as Gain1.k=2")
        place = names.place(name, where)
        if place in seen:
            raise InputRefused(f"{where} {name} is given twice, {seen[place]} and {given}; remove one")
        seen[place] = given
        if place.element:
            value = _value(place.connector, given, names.variable(place), f"{where} {name}={given}")
            assigned.setdefault(place.element, {})[place.connector] = AssignedValue(value, (), ())
            continue
        if place.connector not in flat.entrances:
            raise InputRefused(f"{where} {name}: it is not an input of the system; set the component's variable")
        for end, hops in flat.entrances[place.connector]:
            value = _value(end.connector, given, names.variable(end), f"{where} {name}={given}")
            assigned.setdefault(end.element, {})[end.connector] = AssignedValue(value, (), hops)
    return replace(flat, assigned=assigned)


def overruled_names(flat: FlatSystem, names: SystemNames, additions: Additions) -> Iterator[str]:
    """Yield the names of settings and SSV parameters that target inputs which connections feed."""
    fed = {lead.end for lead in flat.leads}
    yield from (one for one in additions.settings if names.place(one.partition("=")[0].strip(), "--set") in fed)
    by_name = {".".join(end) for end in fed}
    # their bindings were appended to the bindings of the file
    sets = names.package.structure.system.bindings[-len(additions.parameters) :] if additions.parameters else ()
    yield from (one.name for by in sets for one in by.parameters.parameters if one.name in by_name)


def _value(name: str, text: str, variable: Variable, where: str) -> ssp.ParameterValue:
    if variable.is_text:
        if variable.type != "String":
            raise InputRefused(f"{where}: {name} is binary, which cannot be set here")
        return ssp.ParameterValue(name, "String", (text.strip("'\""),))
    found, spelled = _LIST_PATTERN.fullmatch(text), ""
    if found is None and (measured := UNIT_PATTERN.fullmatch(text)):
        text, spelled = measured["value"], measured["unit"]
    texts = [one.strip() for one in found["values"].split(",")] if found else [text]
    if variable.items and not found and _number(text) is None:
        # an enumeration item by name, which the FMU looks up
        return ssp.ParameterValue(name, "Enumeration", (text,))
    numbers = tuple(_typed_number(one, variable, where) for one in texts)
    return ssp.ParameterValue(
        name, variable.type if variable.type in (*ssp.REAL_TYPES, *ssp.INTEGER_TYPES) else "Real", numbers, spelled
    )


def _typed_number(text: str, variable: Variable, where: str) -> float:
    if variable.type == "Boolean":
        if text.lower() not in ssp.BOOLEAN_VALUES:
            raise InputRefused(f"{where}: {variable.name} is Boolean; expected true or false")
        return float(ssp.BOOLEAN_VALUES[text.lower()])
    number = _number(text)
    if number is None:
        raise InputRefused(f"{where}: {variable.name} is {variable.type}; expected a finite number")
    if variable.type not in ssp.REAL_TYPES and not number.is_integer():
        raise InputRefused(f"{where}: {variable.name} is {variable.type}; expected a whole number")
    # an integer beyond the exact range of a double is checked as given, before rounding
    if variable.type not in ssp.REAL_TYPES and (
        why := variable.range_error(int(Decimal(text)) if abs(number) >= MAX_EXACT else number)
    ):
        raise InputRefused(f"{where}: {why}")
    return number


def _number(text: str) -> float | None:
    value = parse_float(text)
    return value if value is not None and math.isfinite(value) else None
