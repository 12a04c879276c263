"""`twin converge`: what the coupling of drives and plant costs."""

import json
from pathlib import Path
from typing import Annotated

import typer

from twin.cli.completion import drive_names, experiment_files, setting_keys
from twin.cli.progress import progress


def converge(
    experiment: Annotated[
        Path,
        typer.Argument(
            metavar="EXPERIMENT", help="Experiment with a reference (TOML).", autocompletion=experiment_files
        ),
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
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")] = False,
) -> None:
    """Halve the step: error, order and power residual of each coupling.

    Runs the experiment in each scheme with held and interpolated inputs at
    several ticks, compares with a reference, and names the longest tick and the
    simplest coupling that keep the force within the tolerance.
    Exit code: 0 done, 1 no coupling does, 2 input refused, 3 a drive failed.

    Example: twin converge experiments/fig4_force_position.toml --duration 6
    """
    from twin.report.convergence import Request, convergence_report

    shown = progress()
    try:
        report = convergence_report(
            Request(experiment, settings or (), drive, tolerance, duration, smooth, out),
            shown.say,
        )
    finally:
        shown.clear()
    print(json.dumps(report.facts) if as_json else report.text)
    if not report.found:
        raise SystemExit(1)
