"""`twin build`: parts of the robot for other people's masters."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from twin.cli.ask import ask
from twin.cli.completion import experiment_files
from twin.cli.options import JOB_ISOLATION, AsJson, Isolate, Settings


Platforms = Annotated[
    list[str] | None, typer.Option(metavar="NAME", help="Also for aarch64-linux, x86_64-windows .. or all; repeat it.")
]


class Fmi(StrEnum):
    """Versions of FMI that are written."""

    TWO = "2"
    THREE = "3"


def build(
    experiment: Annotated[
        Path, typer.Argument(metavar="EXPERIMENT", help="File or name.", autocompletion=experiment_files)
    ],
    fmu: Annotated[str, typer.Option("--fmu", metavar="PART", help="plant, computer, or a component: encoder ..")],
    fmi: Annotated[Fmi, typer.Option(help="Version of FMI.")] = Fmi.TWO,
    platform: Platforms = None,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Without it, results/build/EXPERIMENT/PART.fmu.")
    ] = None,
    settings: Settings = None,
    isolate: Isolate = JOB_ISOLATION,
    as_json: AsJson = False,
) -> None:
    """Build a part of the robot as a co-simulation FMU: native code for x86-64 Linux, without Python.

    plant: springs, mechanism, contact, with body and scale.
    computer: encoders, estimator, controller, delay, monitor.

    Its numbers stay open as parameters, called as in the file.

    Exit code: 0 written, 2 refused, 3 it could not be written.

    Example: twin build fig4_force_position --fmu plant
    """
    asked = {"experiment": experiment, "part": fmu, "fmi": f"{fmi}.0", "platforms": platform or [], "out": out, "settings": settings or []}
    ask("twin.studies.build.study:build_fmu", asked, as_json, isolate)
