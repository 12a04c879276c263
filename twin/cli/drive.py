"""`twin drive`: look at a drive FMU before using it."""

from pathlib import Path
from typing import Annotated, Any

import typer

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
    raise NotImplementedError
