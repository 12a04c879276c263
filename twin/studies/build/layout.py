"""Memory layout of an exported part in one block: FMI variables, inputs and outputs, component memory; and its C."""

import math
import struct
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from twin.kernel.cosim.component import NativeComponent
from twin.kernel.cosim.port import Port, by_port, width
from twin.kernel.cosim.system import End
from twin.kernel.ssp.structure import ConnectorKind
from twin.kernel.units import Unit, known_unit
from twin.studies.build.part import NO_LIMITS, Beginning, Destination, Limits, OpenParameter, RobotPart

MEMORY_ALIGNMENT = 64
"""Alignment (bytes) of component memory and of the arrays it points to."""

Kind = Literal["parameter", "tunable", "input", "output"]
CAUSALITY_BY_KIND: dict[Kind, ConnectorKind] = {
    "parameter": "parameter", "tunable": "parameter", "input": "input", "output": "output",
}  # fmt: skip
"""Causality of an exported variable in FMI, and the kind of its connector in SSP."""
STATUS_TEXTS = {"plant": "left the workspace, a leg cannot reach the platform"}
"""Message for status 2 of a component whose own explanation depends on its current state."""


class ExportedVariable(NamedTuple):
    """A variable of an exported FMU, e.g. `plant.F_ee_B`: one value, or an array of several.

    Attributes:
        unit, text: unit of the values, and its spelling.
        first: index of its first value.
        start: start values; for an output, before any input is known.
    """

    name: str
    kind: Kind
    meaning: str
    unit: Unit
    text: str
    first: int
    start: tuple[float, ...]
    limits: Limits = NO_LIMITS


class Slot(NamedTuple):
    """Place of a parameter value in an exported part's memory: memory[offset] = value * factor / divisor * times."""

    value: int
    offset: int
    factor: float
    divisor: float
    times: float


class EntryRow(NamedTuple):
    """Row of the C table of an exported part: one component, or one of its initial functions.

    Attributes:
        period: in ticks; 0 for a call before the first step only.
        memory: offset of its memory (bytes).
        u, y: index of its first input, and index of its first output among the values.
    """

    component: NativeComponent
    symbol: str
    step: object
    period: int
    memory: int
    u: int
    y: int
    y_size: int


@dataclass(frozen=True)
class Layout:
    """Memory layout of an exported part: the tables of `part.h`, under the same names."""

    variables: tuple[ExportedVariable, ...]
    rows: tuple[EntryRow, ...]
    places: tuple[Slot, ...]
    pointers: tuple[tuple[int, int], ...]
    sources: tuple[int, ...]
    image: bytes

    @property
    def values(self) -> int:
        return sum(len(variable.start) for variable in self.variables)

    def scalars(self) -> tuple[ExportedVariable, ...]:
        """Return the exported variables split into scalars, for FMI 2.0: `p_B[1]`, `p_B[2]`, `p_B[3]`."""
        return tuple(
            variable
            if len(variable.start) == 1
            else variable._replace(name=f"{variable.name}[{n + 1}]", first=variable.first + n, start=(start,))
            for variable in self.variables
            for n, start in enumerate(variable.start)
        )


def layout_of(part: RobotPart, parameters: Sequence[OpenParameter]) -> Layout:
    blocks = list(_blocks(part))
    variables = list(_variables(part, parameters))
    first_of = {variable.name: variable.first for variable in variables}
    places = [
        place
        for parameter in parameters
        for destination in parameter.destinations
        for place in _places(blocks, parameter, first_of[parameter.key], destination)
    ]
    rows = tuple(_rows(part, {block.name: block.offset for block in blocks}, first_of))
    pointers = tuple(
        (_offset(blocks, component.memory[field]), _offset(blocks, array))
        for component in part.components
        for field, array in component.pointers.items()
    )
    sources = tuple(
        _source(part, component, port, n, first_of)
        for component in part.components
        for port in component.inputs
        for n in range(port.size)
    )
    return Layout(tuple(variables), rows, tuple(places), pointers, sources, _image(part, blocks))


class _Block(NamedTuple):
    name: str
    array: np.ndarray
    offset: int


def _blocks(part: RobotPart) -> Iterator[_Block]:
    offset = 0
    for component in part.components:
        for name, array in ((component.name, component.memory), *component.pointers.items()):
            yield _Block(name if array is component.memory else f"{component.name}.{name}", array, offset)
            offset += -(-array.nbytes // MEMORY_ALIGNMENT) * MEMORY_ALIGNMENT


def _offset(blocks: Sequence[_Block], memory: np.ndarray) -> int:
    """Return the offset in bytes of a component's memory array in the exported memory block."""
    address = memory.ctypes.data
    for block in blocks:
        inside = address - block.array.ctypes.data
        if 0 <= inside < block.array.nbytes:
            return block.offset + inside
    raise AssertionError("memory of no component")


def _image(part: RobotPart, blocks: Sequence[_Block]) -> bytes:
    last = blocks[-1]
    image = bytearray(last.offset + -(-last.array.nbytes // MEMORY_ALIGNMENT) * MEMORY_ALIGNMENT)
    for block in blocks:
        image[block.offset : block.offset + block.array.nbytes] = block.array.tobytes()
    for component in part.components:
        # addresses are only valid in this process
        for field in component.pointers:
            at = _offset(blocks, component.memory[field])
            image[at : at + 8] = bytes(8)
    return bytes(image)


def _places(blocks: Sequence[_Block], parameter: OpenParameter, first: int, destination: Destination) -> Iterator[Slot]:
    memory, unit = destination.memory, parameter.unit
    factor, divisor = (unit.scale, 1.0) if unit.pi else (float(unit.factor.numerator), float(unit.factor.denominator))
    for n, index in enumerate(np.ndindex(memory.shape)):
        address = memory[tuple(slice(i, i + 1) for i in index)]
        value = first + (n if len(parameter.start) > 1 else 0)
        # only one divisor can differ from 1, because the factors are multiplied
        assert destination.divisor == 1.0 or divisor == 1.0
        yield Slot(value, _offset(blocks, address), factor, divisor * destination.divisor, destination.times)


def _variables(part: RobotPart, parameters: Sequence[OpenParameter]) -> Iterator[ExportedVariable]:
    first = 0
    for p in parameters:
        kind: Kind = "tunable" if p.tunable else "parameter"
        yield ExportedVariable(p.key, kind, p.meaning, p.unit, _bracket_unit(p.text), first, p.start, p.limits)
        first += len(p.start)
    named: list[tuple[Kind, str, Port, np.ndarray]] = []
    named += [("input", name, port, start) for name, (port, start) in part.starts.items()]
    named += [("output", f"{name}.{port.name}", port, start) for name, port, start in _outputs(part)]
    for kind, name, port, start in named:
        text = port.unit.replace(" ", ".")
        unit = known_unit(text)
        assert unit is not None, f"{name} is in {port.unit}"
        yield ExportedVariable(
            name, kind, port.meaning, unit, _bracket_unit(text), first, tuple(float(x) for x in start)
        )
        first += port.size


def _bracket_unit(text: str) -> str:
    """Return a unit with its denominator in brackets: `mm/(N.s)` for `mm/N.s`."""
    above, per, below = text.partition("/")
    below = below.replace("/", ".")
    return f"{above}{per}({below})" if "." in below else f"{above}{per}{below}"


def _outputs(part: RobotPart) -> Iterator[tuple[str, Port, np.ndarray]]:
    """Yield (component, port, start values) of all outputs of an exported part, in order."""
    for component in part.components:
        for port, start in zip(
            component.outputs, by_port(component.outputs, component.initial_outputs).values(), strict=True
        ):
            yield component.name, port, start
    for name, beginning in _beginnings(part):
        for port in beginning.outputs:
            yield name, port, np.zeros(port.size)


def _beginnings(part: RobotPart) -> list[tuple[str, Beginning]]:
    return [(name, beginning) for name, found in part.beginnings.items() for beginning in found]


def _rows(part: RobotPart, memory: dict[str, int], first_of: dict[str, int]) -> Iterator[EntryRow]:
    u = 0
    placed = {}
    for component in part.components:
        name, outputs = component.name, component.outputs
        y = _first(name, outputs, first_of)
        row = EntryRow(component, f"step_{name}", component.step, component.period, memory[name], u, y, width(outputs))
        placed[name] = row
        yield row
        u += width(component.inputs)
    for n, (name, beginning) in enumerate(_beginnings(part)):
        row = placed[name]._replace(symbol=f"begin_{name}_{n}", step=beginning.step, period=0)
        if beginning.outputs:
            row = row._replace(y=_first(name, beginning.outputs, first_of), y_size=width(beginning.outputs))
        yield row


def _first(component: str, outputs: Sequence[Port], first_of: dict[str, int]) -> int:
    return first_of[f"{component}.{outputs[0].name}"] if outputs else 0


def _source(part: RobotPart, component: NativeComponent, port: Port, n: int, first_of: dict[str, int]) -> int:
    """Return the index of the value that feeds one element of an input of an exported component."""
    end = part.feeds.get(End(component.name, port.name, n))
    if end is None:
        return first_of[port.name] + n
    return first_of[f"{end.component}.{end.port}"] + end.element


def sizes_header(layout: Layout, variables: Sequence[ExportedVariable], guid: str, tick: float) -> str:
    numbers = {
        "N_VARIABLES": len(variables),
        "N_VALUES": layout.values,
        "N_PLACES": len(layout.places),
        "N_POINTERS": len(layout.pointers),
        "N_COMPONENTS": len(layout.rows),
        "N_U": len(layout.sources),
        "MEMORY_BYTES": len(layout.image),
    }
    lines = [f'#define GUID "{guid}"', f"#define TICK {_number(tick)}"]
    return "\n".join([*lines, *(f"#define {name} {number}" for name, number in numbers.items()), ""])


def tables_source(layout: Layout, variables: Sequence[ExportedVariable]) -> str:
    steps = {row.symbol for row in layout.rows}
    doubles = struct.unpack(f"<{len(layout.image) // 8}Q", layout.image)
    return "\n".join(
        [
            '#include "part.h"',
            *(f"DECLARE_STEP({symbol});" for symbol in sorted(steps)),
            _array("Variable", "variables[N_VARIABLES]", map(_variable, variables)),
            _array("double", "start_values[N_VALUES]", (_number(x) for v in layout.variables for x in v.start)),
            _array(
                "Place", "places[N_PLACES + 1]",
                (
                    f"{{{p.value}, {p.offset}, {_number(p.factor)}, {_number(p.divisor)}, {_number(p.times)}}}"
                    for p in layout.places
                ),
            ),
            _array("Pointer", "pointers[N_POINTERS + 1]", (f"{{{field}, {at}}}" for field, at in layout.pointers)),
            _array("Component", "components[N_COMPONENTS]", map(_component, layout.rows)),
            _array("unsigned", "sources[N_U + 1]", map(str, layout.sources)),
            # integers, because a NaN or an infinity would not survive as text
            _array("uint64_t", "image[(MEMORY_BYTES + 7) / 8]", (f"{word}u" for word in doubles)),
            "",
        ]
    )  # fmt: skip


def _array(kind: str, declared: str, values: Iterable[str]) -> str:
    inside = ",\n    ".join(values) or "0"
    return f"static const {kind} {declared} = {{\n    {inside}}};"


def _variable(variable: ExportedVariable) -> str:
    above, at_least, below, at_most = variable.limits
    lower = next((x for x in (above, at_least) if x is not None), -math.inf)
    upper = next((x for x in (below, at_most) if x is not None), math.inf)
    return (
        f'{{"{variable.name}", {variable.kind.upper()}, {variable.first}, {len(variable.start)}, {_number(lower)}, '
        f"{_number(upper)}, {int(above is not None)}, {int(below is not None)}}}"
    )


def _component(row: EntryRow) -> str:
    n_u = sum(port.size for port in row.component.inputs)
    name = row.component.name
    status = f'"{STATUS_TEXTS.get(name) or row.component.explain(2)}"'
    return (
        f'{{"{name}", STEP({row.symbol}), {row.period}, {row.memory}, {row.u}, {n_u}, {row.y}, {row.y_size}, '
        f"{int(row.component.finite)}, {status}}}"
    )


def _number(value: float) -> str:
    """Format a number as a hexadecimal C literal with exactly its value."""
    if math.isinf(value):
        return "-HUGE_VAL" if value < 0 else "HUGE_VAL"
    return float(value).hex()
