"""`twin accuracy`: where the error of the force comes from, in newtons."""

from pathlib import Path
from typing import Annotated, Any

import typer

from twin.cli.ask import ask
from twin.cli.completion import experiment_files
from twin.cli.first_look import look_at_experiments
from twin.cli.options import JOB_ISOLATION, AsJson, DriveName, Isolate, Settings


def accuracy(
    experiment: Annotated[
        Path,
        typer.Argument(metavar="EXPERIMENT", help="Experiment that presses (TOML).", autocompletion=experiment_files),
    ],
    drive: DriveName = None,
    settings: Settings = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Where accuracy.json goes: results/accuracy/EXPERIMENT."),
    ] = None,
    as_json: AsJson = False,
    isolate: Isolate = JOB_ISOLATION,
) -> None:
    """Budget of the force error: encoders, backlash, statics, coupling, parameters.

    Runs the experiment without any imperfection and with each of them alone, and
    says in newtons what each adds to the error of the estimated force.
    Exit code: 0 done, 2 input refused, 3 a drive failed.

    Example: twin accuracy experiments/fig4_force_position.toml
    """
    look_at_experiments([experiment], settings, [drive])
    asked: dict[str, Any] = {"experiment": experiment, "settings": settings or [], "drive": drive, "out": out}
    ask("twin.studies.accuracy.study:budget", asked, as_json, isolate)
