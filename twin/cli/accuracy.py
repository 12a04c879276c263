"""`twin accuracy`: where the error of the force comes from, in newtons."""

import json
from pathlib import Path
from typing import Annotated

import typer

from twin.cli.completion import drive_names, experiment_files, setting_keys
from twin.cli.progress import progress


def accuracy(
    experiment: Annotated[
        Path,
        typer.Argument(metavar="EXPERIMENT", help="Experiment that presses (TOML).", autocompletion=experiment_files),
    ],
    drive: Annotated[
        str | None,
        typer.Option(
            metavar="FMU", help="Drive of every joint: an .fmu file, or a drive of fmus/.", autocompletion=drive_names
        ),
    ] = None,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set", metavar="KEY=VALUE", help="Override a value of the experiment.", autocompletion=setting_keys
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(metavar="DIR", help="Where accuracy.json goes: results/accuracy/EXPERIMENT."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")] = False,
) -> None:
    """Budget of the force error: encoders, backlash, statics, coupling, parameters.

    Runs the experiment without any imperfection and with each of them alone, and
    says in newtons what each adds to the error of the estimated force.
    Exit code: 0 done, 2 input refused, 3 a drive failed.

    Example: twin accuracy experiments/fig4_force_position.toml
    """
    from twin.report.accuracy import accuracy_report

    shown = progress()
    try:
        report = accuracy_report(experiment, settings or (), drive, out, shown.say)
    finally:
        shown.clear()
    print(json.dumps(report.facts) if as_json else report.text)
