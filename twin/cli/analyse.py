"""`twin analyse`: the loops of an experiment, linear."""

from pathlib import Path
from typing import Annotated, Any

import typer

from twin.cli.ask import ask
from twin.cli.completion import experiment_files
from twin.cli.first_look import look_at_experiments
from twin.cli.options import JOB_ISOLATION, AsJson, BodyName, Columns, DriveName, Formats, Isolate, Settings


def analyse(
    experiment: Annotated[
        Path,
        typer.Argument(metavar="EXPERIMENT", help="Experiment file (TOML) or name.", autocompletion=experiment_files),
    ],
    drive: DriveName = None,
    body: BodyName = None,
    settings: Settings = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where pictures and JSON go: results/analysis/EXPERIMENT.")
    ] = None,
    tried: Annotated[
        bool,
        typer.Option(
            "--try/--no-try",
            help="Try the gain limits in the co-simulation; look there for those that do not hold.",
        ),
    ] = True,
    passivity: Annotated[
        bool,
        typer.Option(
            "--passivity",
            help="Instead: what a hand feels of the robot, where it is passive, and the stiffness that it renders.",
        ),
    ] = False,
    formats: Formats = None,
    columns: Columns = 2,
    as_json: AsJson = False,
    isolate: Isolate = JOB_ISOLATION,
) -> None:
    """Tell how stable the loops are: margins, gain limits, damping, pictures.

    Drives are identified through their FMUs; the rest is linearised at rest,
    in free air and pressing, and sampled as the co-simulation samples it.
    The gain limits are then tried in the co-simulation, which decides.
    Exit code: 0 stable at every operating point, 1 unstable at one, 2 input
    refused or no linear model, 3 a drive failed, crashed or hung.

    Example: twin analyse experiments/fig4_force_position.toml
    """
    look_at_experiments([experiment], settings, [drive], body)
    asked: dict[str, Any] = {
        "experiment": experiment,
        "drive": drive,
        "body": body,
        "settings": settings or [],
        "tried": tried,
        "out": out,
    }
    study = "passivity_study:in_the_hand" if passivity else "study:analyse"
    ask(f"twin.studies.analyse.{study}", asked, as_json, isolate, formats=formats, columns=columns)
