"""`twin check`: experiments against their baselines."""

from pathlib import Path
from typing import Annotated, Any

import typer

from twin.cli.ask import ask
from twin.cli.completion import drive_names, experiment_files
from twin.cli.first_look import look_at_files
from twin.cli.options import JOB_ISOLATION, AsJson, Isolate, JobIsolation
from twin.errors import InputRefused

PICTURES = Path("results/check")


def check(
    experiments: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="EXPERIMENT",
            help="Experiments that say what to measure, files or names; none: all that have baselines.",
            autocompletion=experiment_files,
        ),
    ] = None,
    drives: Annotated[
        list[str] | None,
        typer.Option(
            "--drive",
            metavar="FMU",
            help="Drive of fmus/ or .fmu file; own: the experiment's; all: those of fmus/. May be repeated. Without "
            "it, those with a baseline.",
            autocompletion=drive_names,
        ),
    ] = None,
    update: Annotated[bool, typer.Option("--update", help="Accept what is now as the baseline.")] = False,
    reason: Annotated[str, typer.Option(metavar="TEXT", help="Why; kept in the baseline.")] = "",
    baselines: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR",
            help="Where baselines are: tests/baselines here, else those that come with twin; in a clone of twin, "
            "baselines/ beside an experiment of your own.",
        ),
    ] = None,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Where pictures of curves outside their tubes go.")
    ] = PICTURES,
    jobs: Annotated[int, typer.Option("--jobs", "-j", metavar="N", min=1, help="Processes that run experiments.")] = 2,
    isolate: Isolate = JOB_ISOLATION,
    as_json: AsJson = False,
) -> None:
    """Check experiments against what they came to before, drive by drive.

    Numbers have bounds and curves have tubes, stored in tests/baselines as
    docs/regression.md tells. --update shows the difference, then accepts it.
    Of curves outside their tubes there are pictures.

    Exit code: 0 all as it was, or updated; 1 something deviates; 2 input
    refused, or no baseline; 3 a drive failed; 4 the safety monitor tripped.

    Example: twin check experiments/step_z_air.toml --drive velocity_servo
    """
    if update != bool(reason.strip()):
        raise InputRefused('twin check: --update and --reason "why the numbers may move" go together; give both')
    look_at_files(experiments or [])
    asked: dict[str, Any] = {
        "experiments": experiments or [],
        "drives": drives or [],
        "reason": reason if update else "",
        "baselines": baselines,
        "out": out,
        "processes": jobs if isolate == JobIsolation.RUN else 0,
    }
    ask("twin.studies.check.study:check_all", asked, as_json)
