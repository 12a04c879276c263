"""Reader of multi-models (JSON) of Maestro and the INTO-CPS application: FMUs, connections, parameters, algorithm.

Maestro exchanges values between steps, without unit conversion: Jacobi.
"""

import math
import os
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlparse

from twin.kernel.errors import InputRefused
from twin.kernel.files import parse_json, read_bytes
from twin.kernel.ssp import structure as ssp
from twin.kernel.ssp.package import MAX_STRUCTURE_SIZE, Package
from twin.kernel.systems.foreign import foreign_package
from twin.kernel.systems.timing import step_notes

FORM_NAME = "Maestro multi-model"
SUPPORTED_KEYS = ("fmus", "connections", "parameters", "algorithm", "startTime", "endTime")
_NAME_PATTERN = re.compile(r"(?P<fmu>\{[^{}]*\})\.(?P<instance>[^.]+)\.(?P<variable>.+)")


def multi_model(file: Path) -> Package:
    """Read the system of a Maestro multi-model; FMU paths are relative to its folder, else to the working directory."""
    where = f"{file}"
    content = parse_json(read_bytes(file, MAX_STRUCTURE_SIZE), where)
    if not isinstance(content, dict) or not isinstance(content.get("fmus"), dict) or not content["fmus"]:
        raise InputRefused(f'{where}: no "fmus"; expected a multi-model of Maestro')
    files = {key: _file(file, key, source) for key, source in content["fmus"].items()}
    led = [
        (start, end)
        for start, ends in _table(content, "connections", where).items()
        for end in (ends if isinstance(ends, list) else [ends])
    ]
    parameters = _table(content, "parameters", where)
    reader = _InstanceNames(files, where, [*(end for pair in led for end in pair), *parameters])
    wires = tuple(ssp.Connection(reader.end(start), reader.end(end)) for start, end in led)
    values: dict[str, list[ssp.ParameterValue]] = {}
    for name, value in parameters.items():
        end = reader.end(name)
        values.setdefault(end.element, []).append(_value(end.connector, value, f"{where}: {name}"))
    fmus = {name: files[key] for name, key in reader.parts()}
    step, unsaid = _algorithm(content, where)
    others = [key for key in content if key not in SUPPORTED_KEYS]
    unsaid += [f"not read: {', '.join(others)}"] if others else []
    unused = [key for key in files if key not in reader.used]
    unsaid += [f"FMUs without an instance: {', '.join(unused)}"] if unused else []
    given = {name: content.get(name) for name in ("startTime", "endTime")}
    start, stop = (None if one is None else _number(one, f"{where}: {name}") for name, one in given.items())
    times = ssp.DefaultExperiment(start, stop, step_notes("org.into-cps", step))
    system = ssp.SspSystem(file.stem, tuple(ssp.SspComponent(name, "") for name in fmus), wires)
    structure = ssp.Structure(file.stem, system, "", experiment=times)
    return foreign_package(file, FORM_NAME, structure, fmus, values, unsaid)


class _InstanceNames:
    """Resolver of variable names in a multi-model (FMU files by key), and its list of instances.

    `names` are all variable names in it; `used` the keys of FMUs that have an instance.
    """

    def __init__(self, files: Mapping[str, Path], where: str, names: Sequence[Any]):
        self._files, self._where = files, where
        self._found = dict.fromkeys(self._split_name(name)[:2] for name in names)
        self.used = {fmu for fmu, _ in self._found}
        self._same = Counter(instance for _, instance in self._found)

    def end(self, text: Any) -> ssp.Endpoint:
        """Return the (component, variable) of a multi-model's name {fmu}.instance.variable."""
        fmu, instance, variable = self._split_name(text)
        return ssp.Endpoint(self._name(fmu, instance), variable)

    def parts(self) -> list[tuple[str, str]]:
        """Return (component, FMU key) of each instance in the multi-model, in the order of the FMUs."""
        order = {key: number for number, key in enumerate(self._files)}
        return [(self._name(*one), one[0]) for one in sorted(self._found, key=lambda one: order[one[0]])]

    def _split_name(self, text: Any) -> tuple[str, str, str]:
        match = _NAME_PATTERN.fullmatch(text) if isinstance(text, str) else None
        if match is None:
            raise InputRefused(f"{self._where}: '{text}'; expected {{fmu}}.instance.variable")
        if match["fmu"] not in self._files:
            raise InputRefused(f"{self._where}: '{text}': no FMU {match['fmu']}; it has {', '.join(self._files)}")
        return match["fmu"], match["instance"], match["variable"]

    def _name(self, fmu: str, instance: str) -> str:
        # instances of different FMUs may have the same name
        return f"{fmu[1:-1]}_{instance}" if self._same[instance] > 1 else instance


def _table(content: Mapping[str, Any], key: str, where: str) -> dict[str, Any]:
    found = content.get(key) or {}
    if not isinstance(found, dict):
        raise InputRefused(f'{where}: "{key}" is not a table')
    return found


def _file(file: Path, key: str, source: Any) -> Path:
    if not isinstance(source, str):
        raise InputRefused(f"{file}: {key} = {source!r}; expected the path of an FMU")
    try:
        path = Path(unquote(urlparse(source).path)) if source.startswith("file:") else Path(source)
    except ValueError as problem:
        raise InputRefused(f"{file}: {key}: '{source}' is not a URI: {problem}; expected the path of an FMU") from None
    # unlike Path.is_file, os.path.isfile does not raise for a name that is too long
    found = next((one for one in (file.parent / path, path) if os.path.isfile(one)), None)
    if found is None:
        raise InputRefused(f"{file}: {key}: no such FMU: {source}")
    return found


def _value(name: str, value: Any, where: str) -> ssp.ParameterValue:
    if isinstance(value, bool):
        return ssp.ParameterValue(name, "Boolean", (float(value),))
    if isinstance(value, int | float) and math.isfinite(value):
        return ssp.ParameterValue(name, "Real", (float(value),))
    if isinstance(value, str):
        return ssp.ParameterValue(name, "String", (value,))
    raise InputRefused(f"{where} = {value!r}; expected a number, true, false or text")


def _algorithm(content: Mapping[str, Any], where: str) -> tuple[float | None, list[str]]:
    """Return a multi-model's fixed step size (s), None if not fixed, and notes on ignored content."""
    algorithm = content.get("algorithm")
    if not isinstance(algorithm, dict):
        return None, []
    if algorithm.get("type") != "fixed-step":
        return None, [f"algorithm {algorithm.get('type')}; steps of one length instead"]
    return _number(algorithm.get("size"), f"{where}: algorithm size", 0.0), []


def _number(value: Any, what: str, above: float = -math.inf) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not above < value < math.inf:
        raise InputRefused(f"{what} = {value!r}; expected a number{' > 0' if above == 0.0 else ''}")
    return float(value)
