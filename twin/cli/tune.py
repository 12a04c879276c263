"""`twin tune`: gains for given goals."""

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from twin.cli.ask import ask
from twin.cli.completion import experiment_files
from twin.cli.first_look import look_at_experiments
from twin.cli.options import JOB_ISOLATION, AsJson, BodyName, Columns, Formats, Isolate, Settings


def tune(
    experiment: Annotated[
        Path,
        typer.Argument(metavar="EXPERIMENT", help="Experiment file (TOML) or name.", autocompletion=experiment_files),
    ],
    margin: Annotated[float, typer.Option("--margin", metavar="M_S", help="Largest |1/(1+L)| of any loop.")] = 1.6,
    overshoot: Annotated[
        float, typer.Option("--overshoot-percent", metavar="PERCENT", help="Largest overshoot of a step.")
    ] = 5.0,
    bandwidth: Annotated[
        float | None,
        typer.Option("--bandwidth-Hz", metavar="HZ", help="Least bandwidth, of force if it is controlled."),
    ] = None,
    stiffness: Annotated[
        str | None, typer.Option("--stiffness-N-per-m", metavar="LOW:HIGH", help="Stiffness of what is pressed on.")
    ] = None,
    schedule: Annotated[
        bool, typer.Option("--schedule", help="Gains over the stiffness besides, 300:5000 if none is given.")
    ] = False,
    drive: Annotated[
        list[str] | None, typer.Option(metavar="FMU", help="A drive they have to do for; may be repeated.")
    ] = None,
    body: BodyName = None,
    settings: Settings = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where gains, picture, JSON go: results/tuning/EXPERIMENT.")
    ] = None,
    formats: Formats = None,
    columns: Columns = 2,
    as_json: AsJson = False,
    isolate: Isolate = JOB_ISOLATION,
) -> None:
    """Find the fastest gains that keep a margin and an overshoot everywhere.

    Searched on the linear model at every place, stiffness and drive, then
    tried in the co-simulation. The experiment's file is left as it is:
    tuned.toml extends it. Exit code: 0 goals met and confirmed, 1 they are
    not (the best found is told), 2 input refused or no linear model, 3 a
    drive failed, crashed or hung.

    Example: twin tune experiments/fig4_force_position.toml
    """
    drives: list[str | None] = [*drive] if drive else [None]
    look_at_experiments([experiment], settings, drives, body)
    goals = {
        "sensitivity": margin,
        "overshoot": overshoot / 100.0,
        "bandwidth": None if bandwidth is None else 2.0 * math.pi * bandwidth,
    }
    asked: dict[str, Any] = {
        "experiment": experiment,
        "goals": goals,
        "stiffness": stiffness,
        "drives": drives,
        "body": body,
        "settings": settings or [],
        "out": out,
        "schedule": schedule,
    }
    ask("twin.studies.tune.study:tune", asked, as_json, isolate, formats=formats, columns=columns)
