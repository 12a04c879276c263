"""`twin converge`: what the coupling of drives and plant costs."""

from pathlib import Path
from typing import Annotated, Any

import typer

from twin.cli.ask import ask
from twin.cli.completion import experiment_files
from twin.cli.first_look import look_at_experiments
from twin.cli.options import JOB_ISOLATION, AsJson, Columns, DriveName, Formats, Isolate, Settings


def converge(
    experiment: Annotated[
        Path,
        typer.Argument(
            metavar="EXPERIMENT", help="Experiment with a reference (TOML).", autocompletion=experiment_files
        ),
    ],
    drive: DriveName = None,
    settings: Settings = None,
    tolerance: Annotated[
        float, typer.Option(metavar="N", min=0.0, help="Error of the pressing force that may be.")
    ] = 0.005,
    duration: Annotated[
        float | None, typer.Option(metavar="S", min=0.01, help="How much of the experiment; without it, all.")
    ] = None,
    smooth: Annotated[
        bool, typer.Option("--smooth", help="Without backlash and friction, so that orders are clean.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where files go: results/converge/EXPERIMENT.")
    ] = None,
    formats: Formats = None,
    columns: Columns = 2,
    as_json: AsJson = False,
    isolate: Isolate = JOB_ISOLATION,
) -> None:
    """Halve the step: error, order and power residual of each coupling.

    Runs the experiment in each scheme with held and interpolated inputs at
    several ticks, compares with a reference, and names the longest tick and the
    simplest coupling that keep the force within the tolerance.
    Exit code: 0 done, 1 no coupling does, 2 input refused, 3 a drive failed.

    Example: twin converge experiments/fig4_force_position.toml --duration 6
    """
    look_at_experiments([experiment], settings, [drive])
    asked: dict[str, Any] = {
        "experiment": experiment,
        "settings": settings or [],
        "drive": drive,
        "tolerance": tolerance,
        "duration": duration,
        "smooth": smooth,
        "out": out,
    }
    ask("twin.studies.converge.study:converge", asked, as_json, isolate, formats=formats, columns=columns)
