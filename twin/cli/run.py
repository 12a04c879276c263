"""`twin run`: experiments in, recordings out."""

import math
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from twin.cli.ahead import JOB
from twin.cli.completion import experiment_files
from twin.cli.options import ISOLATION, BodyName, DriveName, Isolation, LimitStep, LimitWall, Settings
from twin.cli.report import Listener, Reported
from twin.cli.terminal import Display
from twin.errors import ComponentFailed, InputRefused
from twin.runs.guard.guard import GRACE, JobEnded, guarded
from twin.runs.guard.interrupt import INTERRUPTED
from twin.runs.guard.job import function_called
from twin.runs.guard.limits import LONG, JobLimits
from twin.runs.guard.recorded import left_behind, recorded_until_then

LIVE_JOB = "twin.runs.live.runs:served_runs"
PORT = 8765
MEMORY = 4000.0


class Command(TyperCommand):
    """`--realtime` without a factor means 1; Typer knows no options whose value may be left out."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        return super().parse_args(ctx, ["--realtime=1" if arg == "--realtime" else arg for arg in args])


def run(
    experiments: Annotated[
        list[Path],
        typer.Argument(
            metavar="EXPERIMENT", help="Experiment files (TOML), or names.", autocompletion=experiment_files
        ),
    ],
    drive: DriveName = None,
    body: BodyName = None,
    settings: Settings = None,
    ranges: Annotated[
        list[str] | None,
        typer.Option(
            "--sweep", metavar="KEY=FROM:TO:COUNT", help="Run once per value, as twin sweep does; rows, no recordings."
        ),
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="The run's own folder; without it, results/EXPERIMENT/TIME.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object per run instead of text.")] = False,
    report: Annotated[bool, typer.Option("--report", help="Then write an HTML page, as twin report does.")] = False,
    isolate: Annotated[
        Isolation,
        typer.Option(help="Processes: one for the run; one for each drive besides; none, for debuggers, but this one."),
    ] = ISOLATION,
    limit_step: LimitStep = JobLimits.step,
    limit_wall: LimitWall = math.inf,
    limit_memory: Annotated[
        float, typer.Option(metavar="MB", min=0.0, help="Most memory of the run's process.")
    ] = MEMORY,
    live: Annotated[
        bool, typer.Option("--live", help="Serve the run to Lichtblick or Foxglove; starts with the first viewer.")
    ] = False,
    port: Annotated[int, typer.Option(min=0, max=65535, help="Of --live; 0: any that is free.")] = PORT,
    origins: Annotated[
        list[str] | None,
        typer.Option("--origin", metavar="ORIGIN", help="Of --live; pages of it may watch, too, as https://host:port."),
    ] = None,
    realtime: Annotated[
        float | None,
        typer.Option(metavar="[=FACTOR]", min=0.0, help="Times real time; 1 with --live. 0: as fast as it goes."),
    ] = None,
    yes: Annotated[bool, typer.Option("--yes", help="Run what takes more than an hour or 5 GB.")] = False,
) -> None:
    """Run experiments and record them.

    Exit code: 0 done, 3 a component failed while running (error, crash, hang),
    2 input refused (also an FMU that crashes before the first step), 4 the safety
    monitor tripped although the experiment has no faults, 130 interrupted.

    Example: twin run experiments/fig4_force_position.toml --drive pmsm_foc
    """
    if ranges:
        others = (body, report, live, realtime is not None, isolate != Isolation.RUN, limit_wall < math.inf)
        if len(experiments) > 1 or any(others) or limit_memory != MEMORY:
            raise InputRefused(
                "--sweep: takes one experiment and --drive, --set, --out, --limit-step, --json; "
                "for more, write a sweep file for twin sweep"
            )
        _sweep(experiments[0], ranges, drive, settings or [], out, limit_step, as_json, yes)
        return
    if out is not None and len(experiments) > 1:
        raise InputRefused(f"--out {out}: names the folder of one run; {len(experiments)} experiments were given")
    if isolate != Isolation.NONE and os.name != "posix":
        raise InputRefused(f"--isolate {isolate}: needs Linux or macOS; use --isolate none here")
    if realtime is not None and not math.isfinite(realtime):
        raise InputRefused(f"--realtime={realtime}: expected a finite factor; 0 runs as fast as it goes")
    arguments = {
        "experiments": [str(path) for path in experiments],
        "settings": settings or [],
        "drive": drive,
        "body": body,
        "out": str(out) if out else None,
        "isolate_drives": isolate == Isolation.DRIVE,
        "limit_step": limit_step,
        "factor": realtime if realtime is not None or not live else 1.0,
        "sure": yes,
        **({"port": port, "origins": origins or []} if live else {}),
    }
    job = LIVE_JOB if live else JOB
    with Reported(report, as_json) as reported, Display(as_json) as display:
        hear = reported.noting(display.hear)
        try:
            if isolate == Isolation.NONE:
                _run_here(job, arguments, hear, display.show)
            else:
                # the run itself notices a drive of its own that is stuck, and ends better than if it is ended
                patience = limit_step + (GRACE if isolate == Isolation.DRIVE else 0.0)
                # a paced run takes what it was told to take
                expected = math.inf if yes or arguments["factor"] else LONG
                limits = JobLimits(patience, limit_wall, 1e6 * limit_memory, expected)
                guarded(job, arguments, limits, hear, display.show)
        except JobEnded as failure:
            raise ComponentFailed(f"{failure}\n{recorded_until_then(display.folder)}") from None
        except KeyboardInterrupt:
            if display.folder is None:
                raise
            display.clear()
            print(left_behind(display.folder), file=sys.stderr)
            raise SystemExit(INTERRUPTED) from None


def _run_here(job: str, arguments: dict[str, Any], hear: Listener, show: Callable[[int, int], None]) -> None:
    from twin.runs.guard.reporter import DirectReporter

    function_called(job)(DirectReporter(hear, show), **arguments)


def _sweep(
    experiment: Path,
    ranges: list[str],
    drive: str | None,
    settings: list[str],
    out: Path | None,
    limit_step: float,
    as_json: bool,
    sure: bool,
) -> None:
    from twin.cli.sweep import How, carry_out, check_start
    from twin.experiment.drive_files import experiment_file
    from twin.runs.guard.limits import cores
    from twin.studies.sweep.definition import short_definition
    from twin.studies.sweep.folder import HOME
    from twin.studies.sweep.plan import plan_of

    experiment = experiment_file(experiment)
    definition = short_definition(experiment, ranges, drive)
    place = f"--sweep {' '.join(ranges)}"
    check_start(place, definition, sure)
    plan = plan_of(definition, experiment, experiment.stem, place, settings)
    # other ranges are another sweep; the same command goes on with its own
    folder = out or HOME / f"{plan.name}-{plan.configuration['the sweep'][:8]}"
    carry_out(lambda: plan, How(folder, cores(), "none", limit_step, False, False, None, as_json, sure))
