"""Options that several commands share: one meaning, one wording, one completion."""

from enum import StrEnum
from itertools import pairwise
from typing import Annotated, Any

import typer

from twin.cli import completion
from twin.studies.command import BODY, DRIVE, ISOLATE, JOB_ISOLATION, SETTING, Argument, JobIsolation, Option

COMPLETIONS = {
    "experiment": completion.experiment_files,
    "drive": completion.drive_names,
    "body": completion.body_names,
    "setting": completion.setting_keys,
    "role": completion.role_names,
}


def typer_option(option: Option, flags: str = "") -> Any:
    """`option` as Typer has it; `flags` where it has none of its own and Typer's would not do."""
    said: dict[str, Any] = {"help": option.help, "metavar": option.metavar, "min": option.least, "max": option.most}
    said["autocompletion"] = COMPLETIONS.get(option.complete)
    if isinstance(option, Argument):
        return typer.Argument(**said)
    return typer.Option(*(option.flags or flags).split(), **said)


DriveName = Annotated[str | None, typer_option(DRIVE)]
BodyName = Annotated[str | None, typer_option(BODY)]
Settings = Annotated[list[str] | None, typer_option(SETTING)]
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
Isolate = Annotated[JobIsolation, typer_option(ISOLATE)]
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
