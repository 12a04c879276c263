"""Options that several commands share: one meaning, one wording, one completion."""

from enum import StrEnum
from itertools import pairwise
from typing import Annotated

import typer

from twin.cli.completion import body_names, drive_names, setting_keys
from twin.studies.command import JOB_ISOLATION, JobIsolation

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
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override a value of the experiment, such as controller.force_N=4; of its first task: task.1.force_N=5.",
        autocompletion=setting_keys,
    ),
]
ColumnMap = Annotated[
    list[str] | None,
    typer.Option("--map", metavar="NAME=COLUMN[UNIT]", help="Which column is what; or a TOML file of such."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]
Compile = Annotated[
    bool, typer.Option("--compile", help="Build FMUs without a binary for this machine from their sources, once.")
]


class PictureFormat(StrEnum):
    """What pictures are written as for a paper."""

    SVG = "svg"
    PDF = "pdf"


Formats = Annotated[
    list[PictureFormat] | None,
    typer.Option("--format", help="Pictures for a paper, beside those for the screen; may be repeated."),
]
Columns = Annotated[int, typer.Option("--columns", min=1, max=2, help="Of --format; columns of the paper they fill.")]


class Isolation(StrEnum):
    """What lives in a process of its own."""

    RUN = "run"
    DRIVE = "drive"
    NONE = "none"


ISOLATION = Isolation(JOB_ISOLATION)
Isolate = Annotated[
    JobIsolation,
    typer.Option("--isolate", help="Processes: one of its own for what steps FMUs; none, for debuggers, but this one."),
]
LimitStep = Annotated[float, typer.Option(metavar="S", min=0.0, help="Longest time of one call into a drive.")]
LimitWall = Annotated[float, typer.Option(metavar="S", min=0.0, help="Longest time of the whole command.")]


def as_spelt_now(words: list[str]) -> list[str]:
    """A command line with --isolate and --no-isolate, as some commands called them, in today's spelling."""
    return [
        "--isolate=none"
        if word == "--no-isolate"
        else "--isolate=run"
        if word == "--isolate" and following not in list(Isolation)
        else word
        for word, following in pairwise([*words, ""])
    ]
