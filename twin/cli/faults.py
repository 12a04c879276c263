"""`twin faults`: the matrix of faults of an experiment."""

from pathlib import Path
from typing import Annotated, Any

import typer

from twin.cli.ask import ask
from twin.cli.completion import experiment_files
from twin.cli.first_look import look_at_experiments
from twin.cli.options import JOB_ISOLATION, AsJson, BodyName, Columns, DriveName, Formats, Isolate, Settings
from twin.errors import ComponentFailed


def faults(
    experiment: Annotated[
        Path,
        typer.Argument(
            metavar="EXPERIMENT", help="Experiment with a safety monitor (TOML).", autocompletion=experiment_files
        ),
    ],
    kinds: Annotated[
        list[str] | None, typer.Option("--kind", metavar="KIND", help="Only this kind of fault; may be repeated.")
    ] = None,
    onsets: Annotated[
        list[float] | None,
        typer.Option("--onset", metavar="S", help="When; may be repeated. Without it once free, once in contact."),
    ] = None,
    duration: Annotated[
        float | None, typer.Option(metavar="S", help="How long each fault lasts; without it, to the end.")
    ] = None,
    drive: DriveName = None,
    body: BodyName = None,
    settings: Settings = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Where rows, picture and JSON go: results/faults/EXPERIMENT.")
    ] = None,
    formats: Formats = None,
    columns: Columns = 2,
    as_json: AsJson = False,
    isolate: Isolate = JOB_ISOLATION,
) -> None:
    """Break everything once: each kind of fault, with the safety monitor and without.

    The catalogue of faults says before the run which ones the monitor sees, and
    where the force goes beyond the force limit plus 20 % all the same.
    Exit code: 0 it is so, 1 one is missed or goes beyond without having been
    said to, 2 input refused, 3 a drive crashed or hung (the rows until then are
    kept), 4 the monitor tripped without any fault.

    Example: twin faults experiments/pressing.toml --kind drive_runaway --onset 6
    """
    look_at_experiments([experiment], settings, [drive], body)
    asked: dict[str, Any] = {
        "experiment": experiment,
        "kinds": kinds or [],
        "onsets": onsets or [],
        "duration": duration,
        "drive": drive,
        "body": body,
        "settings": settings or [],
        "out": out,
    }
    try:
        ask("twin.studies.faults.study:break_everything", asked, as_json, isolate, formats=formats, columns=columns)
    except ComponentFailed as failure:
        from twin.studies.faults.study import HOME, ROWS

        rows = (out or HOME / experiment.stem) / ROWS
        kept = rows.read_text().count("\n") if rows.exists() else 0
        raise ComponentFailed(f"{failure}\nKept until then: {rows} ({kept} rows)." if kept else str(failure)) from None
