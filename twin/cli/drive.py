"""`twin drive`: look at a drive FMU before using it."""

import json
import math
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from twin.assembly.drives import DrivePlan
    from twin.drive.description import Variable

WIDTH = 80

app = typer.Typer(help="Look at drive FMUs.", no_args_is_help=True)


@app.callback()
def drive() -> None:
    """Look at drive FMUs."""


@app.command()
def info(
    fmu: Annotated[str, typer.Argument(metavar="FMU", help="An .fmu file, a drive's folder, or a name in fmus/.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Show what a drive FMU is and offers, without loading its binary.

    Exit code: 0 it fits the drive contract, 2 it does not.
    """
    from twin.assembly.drives import planned
    from twin.experiment.drive_files import lone_drive

    plan = planned(lone_drive(str(fmu), Path.cwd()))
    print(json.dumps(_facts(plan)) if as_json else _table(plan))


def _facts(plan: "DrivePlan") -> dict[str, object]:
    return {
        "command": plan.table.command,
        "fmus": [
            {
                "part": part,
                "file": str(fmu.path),
                "sha256": fmu.sha256,
                "fmi_version": fmu.model.fmiVersion,
                "model_name": fmu.model.modelName,
                "description": fmu.model.description,
                "generation_tool": fmu.model.generationTool,
                "platforms": list(fmu.platforms),
                "get_set_state": bool(fmu.model.coSimulation.canGetAndSetFMUstate),
                "parameters": {v.name: _parameter(v) for v in fmu.offered("parameter")},
                "validation": fmu.warnings(),
            }
            for part, fmu in plan.parts.items()
        ],
        "roles": {
            b.port.name: {"variable": b.name, "causality": b.role.causality, "unit": b.variable.unit, "gain": b.gain}
            for b in plan.bindings
        },
        "warnings": plan.warnings(),
    }


def _parameter(v: "Variable") -> dict[str, object]:
    numbers = {"start": v.start, "min": v.low, "max": v.high}
    stated = {key: None if math.isnan(value) else value for key, value in numbers.items()}
    return {"unit": v.unit or None, **stated, "description": v.description}


def _table(plan: "DrivePlan") -> str:
    lines: list[str] = []
    for part, fmu in plan.parts.items():
        lines += [
            f"{part + ': ' if part else ''}{fmu.path.name}  {fmu.model.modelName}, FMI {fmu.model.fmiVersion} co-simulation",
            *textwrap.wrap(fmu.model.description or "", WIDTH, initial_indent="  ", subsequent_indent="  "),
            f"  sha256     {fmu.sha256}",
            f"  binaries   {', '.join(fmu.platforms)}",
            f"  made with  {fmu.model.generationTool or 'not stated'}",
            "",
        ]
    lines.append(f"Commanded with a {plan.table.command}; mapped by name, unit and causality:")
    for b in plan.bindings:
        arrow = "<-" if b.role.causality == "input" else "->"
        unit = f"[{b.variable.unit}]" if b.variable.unit else "[no unit]"
        lines.append(f"  {b.port.name:10} {arrow} {b.name:20} {unit:9} {b.port.meaning}"[:WIDTH])
    for part, fmu in plan.parts.items():
        offered = fmu.offered("parameter")
        lines += ["", f"Parameters{' of ' if part else ''}{part}" if offered else "No parameters"]
        for v in offered:
            head = f"  {v.name:14} {v.start:>9g} {v.unit or '1':13} "
            indent = " " * len(head)
            lines += textwrap.wrap(v.description or "-", WIDTH, initial_indent=head, subsequent_indent=indent)
    warnings = plan.warnings() + [text for fmu in plan.parts.values() for text in fmu.warnings()]
    lines += [line for text in warnings for line in textwrap.wrap(f"warning: {text}", WIDTH, subsequent_indent="  ")]
    return "\n".join(lines)
