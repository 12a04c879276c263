"""Variables of FMUs as ports of components."""

from collections.abc import Sequence
from dataclasses import replace

from twin.cosim.port import Port
from twin.drive.stepping import FmuPort
from twin.drive.variable import Variable
from twin.studies.systems.naming import distinct, field

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
