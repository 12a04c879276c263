"""C library of the robot's computer: header, field tables, static libraries, example program."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from twin.kernel.atomic_write import make_folder, write_bytes
from twin.kernel.cosim.port import Port
from twin.kernel.errors import translate_disk_errors
from twin.robot.assembly.load import load_experiment
from twin.robot.monitor.reasons import Reason
from twin.studies.build import linking
from twin.studies.build.fmu import RESULTS_FOLDER
from twin.studies.build.layout import STATUS_TEXTS, ExportedVariable, Layout, layout_of, sizes_header, tables_source
from twin.studies.build.part import Limits, RobotPart, drive_commands, fixed_keys, open_parameters, part_of
from twin.studies.command import Answer

COUNT_PORTS = (
    Port("count_m", 3, "1", "motor encoders", "int"),
    Port("count_l", 3, "1", "encoders of the proximal links", "int"),
    Port("sample", 1, "1", "number of the encoder message, from 1, one more with each; a monitor looks at it", "int"),
)
"""Inputs of the library, whether or not the part has a component that reads them."""
COMMAND_PORTS = {
    "omega_ref": Port("omega_ref", 3, "rad/s", "speeds of the motor shafts, for the drives"),
    "enable": Port("power", 1, "1", "whether the drives may have power; without a monitor always", "bool"),
}
"""Commands for the drives, by input of the drives."""
C_TYPES = {"double": "double", "int": "int64_t", "bool": "bool"}
LIBRARY_PART = "controls"
LIBRARY_FILE = "libcomputer.a"
SYMBOL_PREFIX = "computer_"
"""Prefix of all exported names of the library."""


def step_ticks(part: RobotPart) -> int:
    """Return the ticks per step of the exported C library: the greatest common divisor of the component periods."""
    return math.gcd(*(component.period for component in part.components))


def header(part: RobotPart, layout: Layout) -> bytes:
    experiment = part.experiment
    tick = experiment.cosim.tick
    parameters: dict[str, Any] = {}
    for variable in parameters_of(layout):
        inside = parameters
        *tables, name = variable.name.split(".")
        for table in tables:
            inside = inside.setdefault(table, {})
        inside[name] = variable
    fields: dict[str, Any] = {port.name: port for port in COMMAND_PORTS.values()}
    fields |= {component.name: {port.name: port for port in component.outputs} for component in part.components}
    types = [
        f"/* {experiment.title}. Seconds from one step to the next, and from one encoder message to the next. */",
        f"#define COMPUTER_STEP_S {step_ticks(part) * tick!r}",
        f"#define COMPUTER_SAMPLE_S {experiment.controller_ticks * tick!r}",
        "",
        "/* The newest encoder message. An angle is count * 2 pi / counts per turn - zero; with angles of 0 the links",
        " * are horizontal outward and the springs unloaded, positive angles lower the platform. */",
        *_struct("computer_counts", {port.name: port for port in COUNT_PORTS}),
        "",
        "/* Called as in the experiment's file. */",
        *_struct("computer_parameters", parameters),
        "",
        "/* The drives' commands, and all outputs of each component. */",
        *_struct("computer_output", fields),
        "",
        "typedef struct {",
        f"    uint64_t opaque[{_words(layout)}];",
        "} computer;",
    ]
    template = linking.c_files("computer.h")["computer.h"].decode()
    return template.replace("/* TYPES */", "\n".join(types)).encode()


def fields(part: RobotPart, layout: Layout) -> bytes:
    """Return the content of fields.c, the tables of parameters, error messages and ports of the exported C library."""
    parameters = parameters_of(layout)
    places = [
        f"{{offsetof(computer_parameters, {v.name}), {_text(f'{v.name}: expected {expected_range(v.limits)}')}, "
        f"{_text(f'{v.name}: only computer_init takes another value')}}}"
        for v in parameters
    ]
    failures = [
        f"{{{_text(f'{c.name}: {STATUS_TEXTS.get(c.name) or c.explain(2)}')}, "
        f"{_text(f'{c.name}: an output is not finite')}}}"
        for c in (row.component for row in layout.rows)
    ]
    first = {v.name: v.first for v in layout.variables}
    take = [
        f"state->values[{first[port.name] + n}] = (double)counts->{_element(port.name, port, n)};"
        for port in COUNT_PORTS
        if port.name in first
        for n in range(port.size)
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
            "static void give(const State *state, computer_output *out)\n{",
            *(f"    {line}" for line in _output_lines(part, first)),
            "}",
            "",
        ]
    ).encode()


def parameters_of(layout: Layout) -> list[ExportedVariable]:
    return [v for v in layout.variables if v.kind in ("parameter", "tunable")]


def expected_range(limits: Limits) -> str:
    """Format the limits of a parameter as text, such as `more than 0, at most 1`."""
    words = zip(("more than", "at least", "less than", "at most"), limits, strict=True)
    return ", ".join(f"{word} {limit:g}" for word, limit in words if limit is not None) or "a finite number"


def _output_lines(part: RobotPart, first: Mapping[str, int]) -> Iterator[str]:
    feeding = drive_commands(part)
    for port_of_drive, port in COMMAND_PORTS.items():
        place = first[feeding[port_of_drive]] if port_of_drive in feeding else None
        yield from _assignment_lines(f"out->{port.name}", port, place)
    for component in part.components:
        for port in component.outputs:
            yield from _assignment_lines(
                f"out->{component.name}.{port.name}", port, first[f"{component.name}.{port.name}"]
            )


def _assignment_lines(target: str, port: Port, first: int | None) -> Iterator[str]:
    for n in range(port.size):
        value = "1.0" if first is None else f"state->values[{first + n}]"
        value = f"{value} != 0.0" if port.kind == "bool" else f"({C_TYPES[port.kind]}){value}"
        yield f"{_element(target, port, n)} = {value};"


def _element(name: str, port: Port, n: int) -> str:
    return f"{name}[{n}]" if port.size > 1 else name


def _words(layout: Layout) -> int:
    """Return the size of the exported C library's `State` in 8-byte words: stamp, mode, two ticks, arrays."""
    return 4 + layout.values + len(layout.sources) + 1 + -(-len(layout.image) // 8)


def _struct(name: str, fields: Mapping[str, Any]) -> Iterator[str]:
    yield "typedef struct {"
    yield from _members(fields, "    ")
    yield f"}} {name};"


def _members(fields: Mapping[str, Any], indent: str) -> Iterator[str]:
    for name, field in fields.items():
        if isinstance(field, Port):
            meaning = field.meaning if field.unit == "1" else f"{field.unit}, {field.meaning}"
            yield _member(indent, C_TYPES[field.kind], name, field.size, meaning)
        elif isinstance(field, ExportedVariable):
            start = ", ".join(f"{x:g}" for x in field.start)
            tunable = "; tunable" if field.kind == "tunable" else ""
            meaning = f"{start}: {field.meaning}; {expected_range(field.limits)}{tunable}"
            yield _member(indent, "double", name, len(field.start), meaning)
        else:
            yield f"{indent}struct {{"
            yield from _members(field, f"{indent}    ")
            yield f"{indent}}} {name};"


def _member(indent: str, kind: str, name: str, size: int, meaning: str) -> str:
    return f"{indent}{kind} {name}{f'[{size}]' if size > 1 else ''};" + (f" /* {meaning} */" if meaning else "")


def _text(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


def build_c(
    experiment: Path,
    platforms: Sequence[str],
    out: Path | None,
    settings: Sequence[str],
    say: Callable[[str], None],
) -> Answer:
    """Write the robot's own computer as C, from encoder counts to motor speeds; options as in `twin build`."""
    targets = linking.select_platforms(platforms)
    loaded = load_experiment(experiment, settings)
    folder = out or RESULTS_FOLDER / loaded.name / "c"
    part = part_of(loaded, LIBRARY_PART)
    linking.refuse_platform(folder, targets)
    offered = open_parameters(part)
    layout = layout_of(part, offered)
    layout = replace(layout, rows=tuple(row._replace(symbol=SYMBOL_PREFIX + row.symbol) for row in layout.rows))
    closed = fixed_keys(part, offered)
    # fail before the slow compilation
    make_folder(folder)
    steps = linking.emit_steps(layout, targets, say)
    source = tables_source(layout, layout.variables).encode()
    shared = linking.c_files("part.h", "part.c", "computer.c", "main.c") | {
        "computer.h": header(part, layout),
        "fields.c": fields(part, layout),
        "tables.c": source,
    }
    guid = linking.guid_of(*(step.content for step in steps[linking.HOST_PLATFORM]), *shared.values())
    shared["sizes.h"] = sizes_header(layout, layout.variables, guid, loaded.cosim.tick).encode()

    def library(platform: linking.Platform) -> bytes:
        return linking.static_library("computer.c", platform, shared | linking.object_files(steps[platform]), folder)

    libraries = linking.link_all(targets, library, say)
    files = {name: shared[name] for name in ("computer.h", "main.c")} | {
        "README.md": _readme(part, targets, closed).encode(),
        **{f"{platform.name}/{LIBRARY_FILE}": content for platform, content in libraries.items()},
    }
    for name, content in files.items():
        make_folder((folder / name).parent)
        write_bytes(folder / name, content)
    with translate_disk_errors(folder, "cannot be tidied"):
        # libraries of an earlier build do not match this header
        for other in linking.PLATFORMS.keys() - {target.name for target in targets}:
            (folder / other / LIBRARY_FILE).unlink(missing_ok=True)
    names = [variable.name for variable in parameters_of(layout)]
    components = [component.name for component in part.components]
    step = step_ticks(part) * loaded.cosim.tick
    text = linking.summary(f"C for the robot's own computer, of {loaded.name}", {
        "runs on": linking.names_of(targets),
        "holds": ", ".join(components),
        "step": f"{1e3 * step:g} ms: counts in, motor speeds out",
        "open": f"{len(names)} parameters, as the experiment's file calls them",
        "fixed": ", ".join(closed),
        "written": f"{folder}: computer.h, main.c, README.md, PLATFORM/{LIBRARY_FILE}",
    })  # fmt: skip
    return Answer(text, {
        "folder": str(folder),
        "files": {name: len(content) for name, content in files.items()},
        "components": components,
        "step_s": step,
        "platforms": [target.name for target in targets],
        "parameters": names,
        "fixed": closed,
    })  # fmt: skip


def _readme(part: RobotPart, platforms: Sequence[linking.Platform], closed: Sequence[str]) -> str:
    experiment = part.experiment
    step = step_ticks(part) * experiment.cosim.tick
    names = ", ".join(component.name for component in part.components)
    rate = f" --rate {1 / step:g}" if step_ticks(part) < experiment.controller_ticks else ""
    reasons = ", ".join(f"{reason.value} {reason.name.lower().replace('_', ' ')}" for reason in Reason)
    lines = [
        f"# The robot's computer of {experiment.title}",
        "",
        f"{names}: from the counts of the encoders to the speeds of the drives, the same code that the twin runs.",
        f"A step every {1e3 * step:g} ms reads the counts of that instant; in the twin the drives receive the result",
        "at the same instant. `computer.h` declares the inputs, the outputs and the parameters;",
        "`main.c` reads counts from a file and prints the drives' commands:",
        "",
        "```sh",
        *(_compile(platform) for platform in platforms),
        f"twin export RUN --csv --signals encoder{rate} --out counts.csv",
        "./main counts.csv",
        "```",
        "",
        "A library needs libm, and `memcpy` and `memset`, which compilers assume; all names in it begin",
        f"with `{SYMBOL_PREFIX}`. On x86-64 Linux its numbers are the twin's, bit for bit; another libm may "
        "change the last bit of",
        "`sin`, `cos` or `exp`.",
        "",
        *([f"`monitor.reason`: {reasons}.", ""] if part.component("monitor") else []),
        f"Fixed, because values were computed from these at build time: {', '.join(closed)}.",
        "",
    ]
    return "\n".join(lines)


def _compile(platform: linking.Platform) -> str:
    if platform is linking.HOST_PLATFORM:
        return f"cc -O2 main.c {linking.HOST_PLATFORM.name}/{LIBRARY_FILE} -lm -o main"
    suffix = ".exe" if platform.suffix == "dll" else ""
    libm = " -lm" if platform.is_elf else ""
    target = platform.target
    return f"python -m ziglang cc -target {target} -O2 main.c {platform.name}/{LIBRARY_FILE}{libm} -o main{suffix}"
