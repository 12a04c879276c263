"""Names and ports for the variables of a system: identifiers in the master and in recordings."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

from twin.kernel.cosim.port import Port
from twin.kernel.fmi.stepping import FmuPort
from twin.kernel.fmi.variable import Variable

SINGLE_FORM = "FMU"
"""Format name of a system that consists of one FMU."""

_ELEMENT_PATTERN = re.compile(r"(.+)\[(\d+)\]")
FIELD_KINDS = {"Real": "double", "Float64": "double", "Float32": "double", "Boolean": "bool"}
"""Field type in a recording by variable type; all other types are integers."""


def identifier(name: str) -> str:
    """Convert text to an identifier: letters, digits and underscores, beginning with a letter."""
    text = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "x"
    return text if text[0].isalpha() else f"x_{text}"


def unique_names(names: Iterable[str]) -> list[str]:
    """Make names unique by appending numbers to repeated ones."""
    seen: set[str] = set()
    numbers: dict[str, int] = {}
    found = []
    for name in names:
        number = numbers.get(name, 1)
        while (one := name if number == 1 else f"{name}_{number}") in seen:
            number += 1
        seen.add(one)
        numbers[name] = number + 1
        found.append(one)
    return found


def topic_name(path: str) -> str:
    """Convert a component path to a topic name: `arm.motor` to `arm/motor`."""
    return "/".join(identifier(part) for part in path.split("."))


def field_name(variable: str, path: str) -> str:
    """Convert a variable name to a field name, without the prefix of the component at `path`: `arm.tip` to `tip`."""
    return identifier(variable.removeprefix(f"{path.rpartition('.')[2]}."))


def split_element(variable: str) -> tuple[str, int]:
    """Return (array, index) of an array element `tip[2]`; index 0 if the variable is not an element."""
    match = _ELEMENT_PATTERN.fullmatch(variable)
    return (match[1], int(match[2])) if match else (variable, 0)


def type_rank(variable: Variable) -> int:
    """Return the rank of a variable's type: 2 real, 1 integer, 0 Boolean; values fit targets of no lower rank."""
    return {"double": 2, "bool": 0}.get(FIELD_KINDS.get(variable.type, "int"), 1)


def port_of(variable: Variable, path: str) -> Port:
    """Make the port (name, size, unit, meaning) for an FMU variable of the component at `path`."""
    kind = FIELD_KINDS.get(variable.type, "int")
    meaning = f"{variable.name}: {variable.description}" if variable.description else variable.name
    return Port(field_name(variable.name, path), variable.size, variable.unit or "1", meaning, kind)  # type: ignore[arg-type]


def distinct_ports(ports: Sequence[FmuPort]) -> list[FmuPort]:
    """Return copies of `ports` with unique names; repeated names get a number."""
    names = unique_names(port.port.name for port in ports)
    return [replace(port, port=replace(port.port, name=name)) for port, name in zip(ports, names, strict=True)]


def match_names(pattern: str, names: Iterable[str]) -> list[str]:
    """Return the elements of `names` that match `pattern`; * matches any characters, ? a single one."""
    parts = (".*" if c == "*" else "." if c == "?" else re.escape(c) for c in pattern)
    expected = re.compile("".join(parts), re.DOTALL)
    return [name for name in names if expected.fullmatch(name)]
