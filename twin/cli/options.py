"""Options that several commands share: one meaning, one wording, one completion."""

import os
from typing import Annotated

import typer

from twin.cli.completion import body_names, drive_names, setting_keys

DriveName = Annotated[
    str | None,
    typer.Option(
        "--drive",
        metavar="FMU",
        help="Drive of every joint: an .fmu file, or a drive of fmus/.",
        autocompletion=drive_names,
    ),
]
BodyName = Annotated[
    str | None,
    typer.Option(
        "--body",
        metavar="BODY",
        help="What to press on: a file of experiments/bodies/, such as back.",
        autocompletion=body_names,
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option("--set", metavar="KEY=VALUE", help="Override a value of the experiment.", autocompletion=setting_keys),
]
ColumnMap = Annotated[
    list[str] | None,
    typer.Option("--map", metavar="NAME=COLUMN[UNIT]", help="Which column is what; or a TOML file of such."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]
Isolated = Annotated[bool, typer.Option(help="Run the drives in a process of their own.")]
IN_A_PROCESS = os.name == "posix"
"""Where processes can be guarded they are, unless one says no."""
