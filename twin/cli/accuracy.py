"""`twin accuracy`: where the error of the force comes from, in newtons."""

from pathlib import Path
from typing import Annotated, Any

import typer

from twin.cli.completion import experiment_files
from twin.cli.job import finished
from twin.cli.options import JOB_ISOLATION, AsJson, DriveName, Isolate, Settings
from twin.cli.progress import progress
from twin.writing import json_text


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
    shown = progress()
    arguments: dict[str, Any] = {
        "experiment": str(experiment),
        "settings": settings or [],
        "drive": drive,
        "out": None if out is None else str(out),
    }
    try:
        text, facts = finished(budgeted, arguments, isolate, shown.say)
    finally:
        shown.clear()
    print(json_text(facts) if as_json else text)


def budgeted(
    voice: Any, experiment: str, settings: list[str], drive: str | None, out: str | None
) -> tuple[str, dict[str, object]]:
    """(text, facts for JSON) of the budget, and the file of `out`; a job of the guard."""
    from twin.studies.accuracy.study import accuracy_report

    folder = None if out is None else Path(out)
    report = accuracy_report(Path(experiment), settings, drive, folder, lambda what: voice.note(say=what))
    return report.text, report.facts
