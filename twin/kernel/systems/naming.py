"""What components and variables of a system are called in the master and in a recording, where names are words.

Variables of FMUs as ports of components.
"""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

from twin.kernel.cosim.port import Port
from twin.kernel.fmi.stepping import FmuPort
from twin.kernel.fmi.variable import Variable

SINGLE_FORM = "FMU"
"""The form of a system that is one FMU."""

_ELEMENT_PATTERN = re.compile(r"(.+)\[(\d+)\]")
FIELD_KINDS = {"Real": "double", "Float64": "double", "Float32": "double", "Boolean": "bool"}
"""Of a recording, by the type of a variable; whole numbers are all others."""


def identifier(name: str) -> str:
    """`name` with letters, digits and underscores alone, a letter first."""
    text = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "x"
    return text if text[0].isalpha() else f"x_{text}"


def unique_names(names: Iterable[str]) -> list[str]:
    """`names`, those that have come before with a number."""
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
    """Of a component: `arm/motor` of `arm.motor`."""
    return "/".join(identifier(part) for part in path.split("."))


def field_name(variable: str, path: str) -> str:
    """Of a variable of the component at `path`, whose own name in front of it is left out: `tip` of `arm.tip`."""
    return identifier(variable.removeprefix(f"{path.rpartition('.')[2]}."))


def split_element(variable: str) -> tuple[str, int]:
    """(array, number) of a variable that is an element of one, `tip[2]`; number 0: it is none."""
    match = _ELEMENT_PATTERN.fullmatch(variable)
    return (match[1], int(match[2])) if match else (variable, 0)


def type_rank(variable: Variable) -> int:
    """Of its type: 2 real, 1 whole, 0 truth value; a value goes into what has as much room."""
    return {"double": 2, "bool": 0}.get(FIELD_KINDS.get(variable.type, "int"), 1)


def port_of(variable: Variable, path: str) -> Port:
    """The port of a variable of the component at `path`."""
    kind = FIELD_KINDS.get(variable.type, "int")
    meaning = f"{variable.name}: {variable.description}" if variable.description else variable.name
    return Port(field_name(variable.name, path), variable.size, variable.unit or "1", meaning, kind)  # type: ignore[arg-type]


def distinct_ports(ports: Sequence[FmuPort]) -> list[FmuPort]:
    """`ports`, each with a name of its own."""
    names = unique_names(port.port.name for port in ports)
    return [replace(port, port=replace(port.port, name=name)) for port, name in zip(ports, names, strict=True)]


def match_names(pattern: str, names: Iterable[str]) -> list[str]:
    """Those of `names` that `pattern` means, in which * stands for any characters and ? for one."""
    parts = (".*" if c == "*" else "." if c == "?" else re.escape(c) for c in pattern)
    expected = re.compile("".join(parts), re.DOTALL)
    return [name for name in names if expected.fullmatch(name)]
