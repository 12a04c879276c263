"""The drives of fmus/ and the facts of one drive, for `twin drive list` and `twin drive info`."""

import math
import re
import textwrap
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from twin.kernel.errors import InputRefused
from twin.robot.paths import locate_file
from twin.studies.result import Column, Note, Table, lay_out, text_width

if TYPE_CHECKING:
    from twin.kernel.fmi.variable import Variable
    from twin.robot.assembly.drives import DrivePlan

DRIVES_FOLDER = "fmus"
SCHEMA_ERROR = re.compile(r"[A-Z]+ \(line (\d+), column \d+\): (.*)")
"""Message of lxml about an element or attribute that the schema does not have."""
CLAUSE_END = re.compile(r"[,:;] | (?:on|under|with) ")
"""Places at which a description can be cut."""
DRIVE_COLUMNS = (
    Column("drive", left=True),
    Column("kind", 5, left=True, gap=2),
    Column("command", 8, left=True, gap=2),
    Column("FMI", 3, left=True, gap=2),
    Column("what it is", left=True, gap=2),
)


def drive_facts(plan: "DrivePlan") -> dict[str, object]:
    from twin.kernel.fmi.description import capability_rows
    from twin.kernel.fmi.variable import to_json

    return {
        "command": plan.table.command,
        **(
            {"ssp": {"file": str(ssp.path), "sha256": ssp.sha256, "version": ssp.version}}
            if (ssp := plan.system)
            else {}
        ),
        "fmus": [
            {
                "part": part,
                "file": str(fmu.path),
                "sha256": fmu.sha256,
                "fmi_version": fmu.model.fmiVersion,
                "kind": fmu.kind,
                "kinds": list(fmu.kinds),
                "solver": solver._asdict() if (solver := plan.solver(part)) else None,
                "tolerance": plan.tolerance(part),
                "model_name": fmu.model.modelName,
                "description": fmu.model.description,
                "generation_tool": fmu.model.generationTool,
                "platforms": list(fmu.platforms),
                "abilities": [f"{name}: {text}" for name, text in capability_rows(fmu)],
                "parameters": {v.name: _parameter(v) for v in fmu.parameters},
                "get_set_state": bool(fmu.interface.canGetAndSetFMUstate),
                # Warnings refer to an FMU file; FMUs inside an archive are not files.
                "validation": [] if plan.system else fmu.warnings(),
            }
            for part, fmu in plan.parts.items()
        ],
        "roles": {
            b.port.name: {
                "variable": b.mapped_name,
                "causality": b.role.causality,
                "unit": b.variable.unit,
                "gain": b.gain,
            }
            for b in plan.bindings
        },
        "wires": {target: source for source, target in plan.wires},
        "set": {part: {v.name: to_json(value) for v, value in settings} for part, settings in plan.settings.items()},
        "warnings": plan.warnings(),
    }


def _parameter(v: "Variable") -> dict[str, object]:
    numbers = {"start": v.start, "min": v.low, "max": v.high}
    stated = {key: None if math.isnan(value) else value for key, value in numbers.items()}
    named = {"values": dict(v.items)} if v.items else {}
    return {"unit": v.unit or None, **stated, **named, "description": v.description}


def drive_text(plan: "DrivePlan") -> str:
    from twin.kernel.fmi.description import KIND_NAMES, capability_rows
    from twin.kernel.fmi.variable import to_json
    from twin.robot.assembly.drives import qualified_name

    lines: list[str] = []
    if plan.system is not None:
        lines += [f"{plan.label}  SSP {plan.system.version}", f"  sha256     {plan.system.sha256}", ""]
    for part, fmu in plan.parts.items():
        lines += [
            f"{part + ': ' if part else ''}{fmu.path.name}  {fmu.model.modelName}, "
            f"FMI {fmu.model.fmiVersion} {KIND_NAMES[fmu.kind]}",
            *textwrap.wrap(fmu.model.description or "", text_width(), initial_indent="  ", subsequent_indent="  "),
            f"  sha256     {fmu.sha256}",
            f"  binaries   {', '.join(fmu.platforms)}",
            f"  made with  {fmu.model.generationTool or 'not stated'}",
            *(f"  {name:<9}  {text}" for name, text in capability_rows(fmu)),
            *_solver_lines(plan, part),
            "",
        ]
    lines.append(f"Commanded with a {plan.table.command}; mapped by name, unit and causality:")
    for b in plan.bindings:
        arrow = "<-" if b.role.causality == "input" else "->"
        unit = f"[{b.variable.unit}]" if b.variable.unit else "[no unit]"
        lines.append(f"  {b.port.name:10} {arrow} {b.mapped_name:20} {unit:9} {b.port.meaning}"[: text_width()])
    lines += [f"  {source} -> {target}  (wire)" for source, target in plan.wires]
    for part, settings in plan.settings.items():
        texts = [
            (v, v.format_value(value) if isinstance(value, float) else str(to_json(value))) for v, value in settings
        ]
        lines += [f"  {qualified_name(part, v.name)} = {text} {v.unit}  (set)" for v, text in texts]
    for part, fmu in plan.parts.items():
        offered = fmu.parameters
        lines += ["", f"Parameters{' of ' if part else ''}{part}" if offered else "No parameters"]
        columns = [[text(v) for v in offered] for text in (lambda v: v.name, _start, _unit)]
        wide = [max(map(len, column), default=0) for column in columns]
        for v in offered:
            head = f"  {v.name:{wide[0]}} {_start(v):>{wide[1]}} {_unit(v):{wide[2]}} "
            indent = " " * len(head)
            about = " ".join(filter(None, (v.description, f"One of: {', '.join(v.items)}." if v.items else "")))
            lines += textwrap.wrap(about or "-", text_width(), initial_indent=head, subsequent_indent=indent)
    fmus = plan.parts.values() if plan.system is None else ()
    warnings = plan.warnings() + [text for fmu in fmus for text in map(_finding, fmu.warnings())]
    lines += [
        line for text in warnings for line in textwrap.wrap(f"warning: {text}", text_width(), subsequent_indent="  ")
    ]
    return "\n".join(lines)


def _finding(problem: str) -> str:
    """Return a finding of FMPy's validation; lxml reports a violated schema as `ERROR (line 32, column 0): ...`."""
    found = SCHEMA_ERROR.fullmatch(problem)
    return f"modelDescription.xml, line {found[1]}: violates the standard's schema: {found[2]}" if found else problem


def _unit(v: "Variable") -> str:
    return v.unit or "1"


def _start(v: "Variable") -> str:
    if v.is_text:
        return v.type
    return f"{v.size} values" if v.size > 1 else v.format_value(v.start)


def _solver_lines(plan: "DrivePlan", part: str) -> list[str]:
    fmu, solver = plan.parts[part], plan.solver(part)
    if solver is None:
        if plan.system is not None:
            return []
        return ['  offers     model exchange too: kind = "model_exchange"'] if len(fmu.kinds) > 1 else []
    step = "one step per step of the drive" if solver.step is None else f"steps of {1e3 * solver.step:g} ms at most"
    how = f"relative tolerance {plan.tolerance(part):g}" if solver.method == "cvode" else step
    size = f"{fmu.model.numberOfContinuousStates} states, {fmu.model.numberOfEventIndicators} event indicators"
    return [f"  solver     ours, {solver.method}, {how}; {size}"]


class ListedDrive(NamedTuple):
    """A drive's folder in fmus/, whose name `--drive` accepts.

    Attributes:
        kind: "servo" (takes a speed), "motor" (twin's velocity loop commands it), "parts" (several FMUs).
        problem: reason why the drive does not fit; empty if it does. A drive that does not fit has no other facts.
    """

    name: str
    kind: str = ""
    command: str = ""
    fmi: str = ""
    description: str = ""
    problem: str = ""


def listed_drives(start: Path) -> tuple[ListedDrive, ...]:
    """List all drives in fmus/ above `start` by name, with the reason for each unfit one; refuse if missing."""
    shelf = locate_file(DRIVES_FOLDER, start)
    if not shelf.is_dir():
        raise InputRefused(f"{shelf}: no such folder; run this in the project's folder, or name a drive by its path")
    from twin.robot.experiment.experiment_files import drive_names

    return tuple(_drive(shelf / name) for name in drive_names(shelf))


def drives_text(drives: Sequence[ListedDrive]) -> str:
    """Return a line per drive with the beginning of its description, then the problems of drives that do not fit."""
    rows = [
        (one.name, one.kind, one.command, one.fmi, "does not fit, see below" if one.problem else one.description)
        for one in drives
    ]
    *columns, _ = DRIVE_COLUMNS
    widths = [max(map(len, (column.name, *(row[i] for row in rows)))) for i, column in enumerate(columns)]
    room = text_width() - sum(widths) - sum(column.gap for column in DRIVE_COLUMNS[1:])
    short = [(*row, _first_clauses(text, room)) for *row, text in rows]
    problems = [Note(f"{one.name}: {one.problem}", later=2, whole=True) for one in drives if one.problem]
    more = "twin drive info NAME prints the whole description, parameters and wiring"
    return lay_out([Table(DRIVE_COLUMNS, short, indent=0), "", *problems, Note(more)])


def _first_clauses(text: str, length: int) -> str:
    """Return as many clauses of `text` as fit into `length` characters, at least its first words."""
    ends = [found.start() for found in CLAUSE_END.finditer(text) if found.start() <= length]
    return (
        text if len(text) <= length else text[: ends[-1]] if ends else textwrap.shorten(text, length, placeholder="...")
    )


def _drive(folder: Path) -> ListedDrive:
    from twin.robot.assembly.drives import plan_drive
    from twin.robot.experiment.drive_files import load_drive

    try:
        plan = plan_drive(load_drive(str(folder), folder))
    except InputRefused as refusal:
        return ListedDrive(folder.name, problem=str(refusal).splitlines()[0])
    models = [fmu.model for fmu in plan.parts.values()]
    kind = "servo" if plan.table.velocity_loop is None else "motor"
    return ListedDrive(
        name=folder.name,
        kind="parts" if len(models) > 1 else kind,
        command=plan.table.command,
        fmi=", ".join(dict.fromkeys(model.fmiVersion for model in models)),
        description="; ".join(" ".join((model.description or model.modelName).split()) for model in models),
    )
