"""`twin drive`: look at a drive FMU before using it."""

import json
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from twin.drive.description import DriveDescription

WIDTH = 80

app = typer.Typer(help="Look at drive FMUs.", no_args_is_help=True)


@app.callback()
def drive() -> None:
    """Look at drive FMUs."""


@app.command()
def info(
    fmu: Annotated[Path, typer.Argument(metavar="FMU", help="An .fmu file, or a drive's folder.")],
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Show what a drive FMU is and offers, without loading its binary.

    Exit code: 0 it fits the drive contract, 2 it does not.
    """
    from twin.drive.description import described

    description = described(fmu)
    print(json.dumps(_facts(description)) if as_json else _table(description))


def _facts(description: "DriveDescription") -> dict[str, object]:
    model = description.model
    return {
        "file": str(description.path),
        "sha256": description.sha256,
        "fmi_version": model.fmiVersion,
        "model_name": model.modelName,
        "description": model.description,
        "generation_tool": model.generationTool,
        "platforms": list(description.platforms),
        "get_set_state": bool(model.coSimulation.canGetAndSetFMUstate),
        "roles": {
            role.port.name: {
                "causality": role.causality,
                "unit": role.port.unit,
                "unit_stated": role.port.name not in description.unstated,
            }
            for role in description.roles
        },
        "parameters": {
            name: {"unit": v.unit, "start": v.start, "min": v.min, "max": v.max, "description": v.description}
            for name, v in description.parameters.items()
        },
        "warnings": description.warnings(),
    }


def _table(description: "DriveDescription") -> str:
    model = description.model
    lines = [
        f"{description.path.name}  {model.modelName}, FMI {model.fmiVersion} co-simulation",
        *textwrap.wrap(model.description or "", WIDTH, initial_indent="  ", subsequent_indent="  "),
        f"  sha256     {description.sha256}",
        f"  binaries   {', '.join(description.platforms)}",
        f"  made with  {model.generationTool or 'not stated'}",
        "",
        "Drive contract, mapped by name, unit and causality",
    ]
    for role in description.roles:
        arrow = "<-" if role.causality == "input" else "->"
        taken = "" if role.port.name not in description.unstated else " (unit not stated)"
        lines.append(f"  {arrow} {role.port.name:10} {f'[{role.port.unit}]':8} {role.port.meaning}{taken}")
    lines += ["", "Parameters" if description.parameters else "No parameters"]
    for name, v in description.parameters.items():
        value = f"{float(v.start):g}" if v.type == "Real" and v.start is not None else str(v.start)
        head = f"  {name:12} {value:>9} {v.unit or '1':13} "
        lines += textwrap.wrap(v.description or "-", WIDTH, initial_indent=head, subsequent_indent=" " * len(head))
    lines += [line for text in description.warnings() for line in textwrap.wrap(f"warning: {text}", WIDTH)]
    return "\n".join(lines)
