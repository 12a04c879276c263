"""The C of the robot's computer that is the experiment's own: the types of its header, and what fills them."""

import math
from collections.abc import Iterator, Mapping
from typing import Any

from twin.cosim.port import Port
from twin.studies.build.layout import Layout, Variable
from twin.studies.build.linking import c_files
from twin.studies.build.parameters import Limits
from twin.studies.build.part import RobotPart, told_to_drives
from twin.studies.build.tables import STATUS

COUNTS = (
    Port("count_m", 3, "1", "motor encoders", "int"),
    Port("count_l", 3, "1", "encoders of the proximal links", "int"),
    Port("sample", 1, "1", "number of the encoder message, from 1, one more with each; a monitor looks at it", "int"),
)
"""What goes in, whether or not this part has somebody who looks at it."""
TOLD = {
    "omega_ref": Port("omega_ref", 3, "rad/s", "speeds of the motor shafts, for the drives"),
    "enable": Port("power", 1, "1", "whether the drives may have power; without a monitor always", "bool"),
}
"""What the drives get, by their own inputs."""
TYPES = {"double": "double", "int": "int64_t", "bool": "bool"}


def step_ticks(part: RobotPart) -> int:
    """Ticks of one step: the most between which no component is due."""
    return math.gcd(*(component.period for component in part.components))


def header(part: RobotPart, layout: Layout) -> bytes:
    """The file computer.h."""
    experiment = part.experiment
    tick = experiment.cosim.tick
    parameters: dict[str, Any] = {}
    for variable in parameters_of(layout):
        inside = parameters
        *tables, name = variable.name.split(".")
        for table in tables:
            inside = inside.setdefault(table, {})
        inside[name] = variable
    told: dict[str, Any] = {port.name: port for port in TOLD.values()}
    told |= {component.name: {port.name: port for port in component.outputs} for component in part.components}
    types = [
        f"/* {experiment.title}. Seconds from one step to the next, and from one encoder message to the next. */",
        f"#define COMPUTER_STEP_S {step_ticks(part) * tick!r}",
        f"#define COMPUTER_SAMPLE_S {experiment.controller_ticks * tick!r}",
        "",
        "/* The newest encoder message. An angle is count * 2 pi / counts per turn - zero; with angles of 0 the links",
        " * are horizontal outward and the springs unloaded, positive angles lower the platform. */",
        *_struct("computer_counts", {port.name: port for port in COUNTS}),
        "",
        "/* Called as in the experiment's file. */",
        *_struct("computer_parameters", parameters),
        "",
        "/* What the drives are told, and what led to it: all outputs of each component. */",
        *_struct("computer_output", told),
        "",
        "typedef struct {",
        f"    uint64_t opaque[{_words(layout)}];",
        "} computer;",
    ]
    template = c_files("computer.h")["computer.h"].decode()
    return template.replace("/* TYPES */", "\n".join(types)).encode()


def fields(part: RobotPart, layout: Layout) -> bytes:
    """The file fields.c, see `computer.c`."""
    parameters = parameters_of(layout)
    places = [
        f"{{offsetof(computer_parameters, {v.name}), {_text(f'{v.name}: expected {expected(v.limits)}')}, "
        f"{_text(f'{v.name}: only computer_init takes another value')}}}"
        for v in parameters
    ]
    failures = [
        f"{{{_text(f'{c.name}: {STATUS.get(c.name) or c.explain(2)}')}, {_text(f'{c.name}: an output is not finite')}}}"
        for c in (row.component for row in layout.rows)
    ]
    first = {v.name: v.first for v in layout.variables}
    taken = [(port, first[port.name]) for port in COUNTS if port.name in first]
    take = [
        f"state->values[{at + n}] = (double)counts->{_of(port, n)};" for port, at in taken for n in range(port.size)
    ]
    return "\n".join(
        [
            f"enum {{ STEP_TICKS = {step_ticks(part)}, N_PARAMETERS = {len(parameters)} }};",
            "static const struct {\n    size_t place;\n    const char *range, *fixed;\n} parameters[] = {",
            *(f"    {place}," for place in places),
            "};",
            "static const struct {\n    const char *status, *not_finite;\n} failures[] = {",
            *(f"    {failure}," for failure in failures),
            "};",
            "static void take(State *state, const computer_counts *counts)\n{",
            *(f"    {line}" for line in take),
            "}",
            "static void give(const State *state, computer_output *told)\n{",
            *(f"    {line}" for line in _given(part, first)),
            "}",
            "",
        ]
    ).encode()


def parameters_of(layout: Layout) -> list[Variable]:
    """The first of its variables."""
    return [v for v in layout.variables if v.kind in ("parameter", "tunable")]


def expected(limits: Limits) -> str:
    """`more than 0, at most 1`, for people."""
    words = zip(("more than", "at least", "less than", "at most"), limits, strict=True)
    return ", ".join(f"{word} {limit:g}" for word, limit in words if limit is not None) or "a finite number"


def _given(part: RobotPart, first: Mapping[str, int]) -> Iterator[str]:
    feeding = told_to_drives(part)
    for port_of_drive, port in TOLD.items():
        place = first[feeding[port_of_drive]] if port_of_drive in feeding else None
        yield from _filled(f"told->{port.name}", port, place)
    for component in part.components:
        for port in component.outputs:
            yield from _filled(f"told->{component.name}.{port.name}", port, first[f"{component.name}.{port.name}"])


def _filled(target: str, port: Port, first: int | None) -> Iterator[str]:
    for n in range(port.size):
        value = "1.0" if first is None else f"state->values[{first + n}]"
        value = f"{value} != 0.0" if port.kind == "bool" else f"({TYPES[port.kind]}){value}"
        yield f"{target}{f'[{n}]' if port.size > 1 else ''} = {value};"


def _of(port: Port, n: int) -> str:
    return f"{port.name}[{n}]" if port.size > 1 else port.name


def _words(layout: Layout) -> int:
    """8 bytes each that a `State` of part.h takes: stamp, mode, two ticks, and what is of this layout."""
    return 4 + layout.values + len(layout.sources) + 1 + -(-len(layout.image) // 8)


def _struct(name: str, fields: Mapping[str, Any]) -> Iterator[str]:
    yield "typedef struct {"
    yield from _members(fields, "    ")
    yield f"}} {name};"


def _members(fields: Mapping[str, Any], indent: str) -> Iterator[str]:
    for name, field in fields.items():
        if isinstance(field, Port):
            meaning = field.meaning if field.unit == "1" else f"{field.unit}, {field.meaning}"
            yield _member(indent, TYPES[field.kind], name, field.size, meaning)
        elif isinstance(field, Variable):
            start = ", ".join(f"{x:g}" for x in field.start)
            tunable = "; tunable" if field.kind == "tunable" else ""
            meaning = f"{start}: {field.meaning}; {expected(field.limits)}{tunable}"
            yield _member(indent, "double", name, len(field.start), meaning)
        else:
            yield f"{indent}struct {{"
            yield from _members(field, f"{indent}    ")
            yield f"{indent}}} {name};"


def _member(indent: str, kind: str, name: str, size: int, meaning: str) -> str:
    return f"{indent}{kind} {name}{f'[{size}]' if size > 1 else ''};" + (f" /* {meaning} */" if meaning else "")


def _text(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
