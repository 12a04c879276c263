"""`twin falsify`: the worst case by search."""

from pathlib import Path
from typing import Annotated, Any

import typer

from twin.cli.ask import ask
from twin.cli.completion import experiment_files
from twin.cli.first_look import look_at_experiments
from twin.cli.options import AsJson, DriveName, Settings
from twin.cli.sweep import cores


def falsify(
    experiment: Annotated[
        Path, typer.Argument(metavar="EXPERIMENT", help="Experiment (TOML).", autocompletion=experiment_files)
    ],
    requirements: Annotated[
        list[str] | None,
        typer.Option(
            "--requirement",
            metavar="FORMULA",
            help="What has to hold; may be repeated. Without it, the experiment's own requirements.",
        ),
    ] = None,
    kinds: Annotated[
        list[str] | None, typer.Option("--kind", metavar="KIND", help="Only this kind of fault; may be repeated.")
    ] = None,
    bodies: Annotated[
        list[str] | None,
        typer.Option("--body", metavar="BODY", help="Press on this body, too; may be repeated."),
    ] = None,
    runs: Annotated[int, typer.Option("--runs", metavar="N", min=1, help="The most runs with a fault.")] = 240,
    duration: Annotated[
        float | None, typer.Option(metavar="S", help="How long each fault lasts; without it, to the end.")
    ] = None,
    processes: Annotated[
        int | None,
        typer.Option(
            "-j", "--processes", min=1, metavar="N", help="Processes; without it, as many as there are cores."
        ),
    ] = None,
    drive: DriveName = None,
    settings: Settings = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where findings go: results/falsify/EXPERIMENT.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Search for the fault that violates a requirement most.

    Which kind, at which joint, when, how large, with which sign, body and seed.

    A requirement is a formula over recorded signals, such as
    always (|plant.F_ee_B| <= 18 N). What violates it is written as an experiment
    to keep: run it, or hold it in twin check.
    Exit code: 0 nothing found violates it, 1 something does, 2 input refused,
    3 a component failed without any fault, 4 the monitor tripped without any.

    Example: twin falsify experiments/pressing.toml --requirement "always (|plant.F_ee_B| <= 18 N)"
    """
    look_at_experiments([experiment], settings, [drive])
    asked: dict[str, Any] = {
        "experiment": experiment,
        "requirements": requirements or [],
        "kinds": kinds or [],
        "bodies": bodies or [],
        "runs": runs,
        "duration": duration,
        "processes": processes or cores(),
        "drive": drive,
        "settings": settings or [],
        "out": out,
    }
    ask("twin.studies.falsify.study:falsify", asked, as_json)
