"""`twin build`: parts of the robot for other people's masters."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from twin.cli.ask import ask
from twin.cli.completion import experiment_files
from twin.cli.first_look import look_at_experiments
from twin.cli.options import JOB_ISOLATION, AsJson, DriveName, Isolate, Settings
from twin.errors import InputRefused


class Fmi(StrEnum):
    """Versions of FMI that are written."""

    TWO = "2"
    THREE = "3"


Platforms = Annotated[
    list[str] | None, typer.Option(metavar="NAME", help="Also for aarch64-linux, x86_64-windows .. or all; repeat it.")
]


def build(
    experiment: Annotated[
        Path, typer.Argument(metavar="EXPERIMENT", help="File or name.", autocompletion=experiment_files)
    ],
    fmu: Annotated[
        str | None, typer.Option("--fmu", metavar="PART", help="An FMU of plant, computer, or a component: encoder ..")
    ] = None,
    c: Annotated[bool, typer.Option("--c", help="C for the robot's own computer: counts in, speeds out.")] = False,
    ssp: Annotated[bool, typer.Option("--ssp", help="The whole robot, drives too, as a system of FMUs.")] = False,
    fmi: Annotated[Fmi | None, typer.Option(help="Version of FMI; without it 2.")] = None,
    platform: Platforms = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="PATH", help="Without it, results/build/EXPERIMENT/PART.fmu, c, or EXPERIMENT.ssp."),
    ] = None,
    drive: DriveName = None,
    settings: Settings = None,
    isolate: Isolate = JOB_ISOLATION,
    as_json: AsJson = False,
) -> None:
    """Build a part of the robot for other programs: native code without Python.

    --fmu plant: a co-simulation FMU of springs, mechanism, contact, body, scale.
    --fmu computer: one of encoders, estimator, controller, delay, monitor.
    --c: the same from the encoders' counts on, as C with static libraries.
    --ssp: plant, computer and the drives as they came, joined: an SSP archive.

    For x86-64 Linux, and whatever --platform adds. Its numbers stay open as
    parameters, called as in the file.

    Exit code: 0 written, 2 refused, 3 it could not be written.

    Example: twin build fig4_force_position --fmu plant --fmi 3
    """
    if c + ssp + (fmu is not None) != 1:
        raise InputRefused("twin build: expected one of --fmu PART, --c and --ssp: what shall be built")
    if drive is not None and not ssp:
        raise InputRefused("twin build: --drive is of a whole robot; leave it out, or say --ssp")
    look_at_experiments([experiment], settings, [drive])
    asked = {"experiment": experiment, "platforms": platform or [], "out": out, "settings": settings or []}
    if c:
        if fmi is not None:
            raise InputRefused("twin build --c: --fmi is of an FMU; leave it out")
        ask("twin.studies.build.library:build_c", asked, as_json, isolate)
    elif ssp:
        asked |= {"fmi": f"{fmi or Fmi.TWO}.0", "drive": drive}
        ask("twin.studies.build.system:build_ssp", asked, as_json, isolate)
    else:
        asked |= {"part": fmu, "fmi": f"{fmi or Fmi.TWO}.0"}
        ask("twin.studies.build.study:build_fmu", asked, as_json, isolate)
