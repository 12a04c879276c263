"""`twin cosim`: systems of anybody's FMUs, without a robot."""

import math
import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from twin.cli.options import JOB_ISOLATION, AsJson, Compile, Isolate, JobIsolation, LimitStep, LimitWall
from twin.cli.terminal import CompileWatch, progress
from twin.errors import ComponentFailed, InputRefused, visible_lines
from twin.runs.guard.guard import JobEnded, guarded
from twin.runs.guard.limits import JobLimits
from twin.runs.guard.recorded import left_behind, recorded_until_then
from twin.writing import json_text

JOB = "twin.studies.systems.study:recorded_system"


class CouplingScheme(StrEnum):
    """Who sees whose newest values."""

    GAUSS_SEIDEL = "gauss_seidel"
    JACOBI = "jacobi"


def cosim(
    system: Annotated[Path, typer.Argument(metavar="SYSTEM.ssp", help="An SSP archive, 1.0 or 2.0.")],
    scheme: Annotated[
        CouplingScheme,
        typer.Option(help="gauss_seidel: components one after the other, as in the file; jacobi: all at once."),
    ] = CouplingScheme.GAUSS_SEIDEL,
    tick_ms: Annotated[
        float | None, typer.Option(metavar="MS", help="Length of a step; without it, as the system says.")
    ] = None,
    stop_s: Annotated[
        float | None, typer.Option(metavar="S", help="End of the run; without it, of the default experiment.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="The run's own folder; without it, results/cosim/SYSTEM/TIME.")
    ] = None,
    compile_: Compile = False,
    as_json: AsJson = False,
    isolate: Isolate = JOB_ISOLATION,
    limit_step: LimitStep = JobLimits.step,
    limit_wall: LimitWall = math.inf,
) -> None:
    """Run a system of co-simulation FMUs (SSP), and record the outputs of each.

    Exit code: 0 done, 2 input refused, 3 a component failed while running
    (error, crash, hang), 130 interrupted.

    Example: twin cosim system.ssp --scheme jacobi --tick-ms 1
    """
    for option, value in (("--tick-ms", tick_ms), ("--stop-s", stop_s)):
        if value is not None and not 0.0 < value < math.inf:
            raise InputRefused(f"{option} {value:g}: expected a number > 0")
    asked = {
        "system": str(system),
        "tick": None if tick_ms is None else tick_ms / 1000.0,
        "stop": stop_s,
        "scheme": scheme.value,
        "out": str(out) if out else None,
        "compiled": compile_,
    }
    shown = progress()
    watch = CompileWatch(shown)
    folders: list[Path] = []

    def hear(note: dict[str, Any]) -> None:
        folders.append(Path(note["folder"]))
        shown.begin(note["name"], note["duration"])

    def show(done: int, total: int) -> None:
        if done:
            watch.end()
            shown.move(done / total)

    shown.say("loading")
    watch.start()
    try:
        if isolate == JobIsolation.RUN:
            came = guarded(JOB, asked, JobLimits(limit_step, limit_wall), hear, show)
        else:
            from twin.runs.guard.job import function_called
            from twin.runs.guard.reporter import DirectReporter

            came = function_called(JOB)(DirectReporter(hear, show), **asked)
    except JobEnded as failure:
        raise ComponentFailed(f"{failure}\n{recorded_until_then(folders[0] if folders else None)}") from None
    except KeyboardInterrupt:
        if not folders:
            raise
        shown.clear()
        print(left_behind(folders[0]), file=sys.stderr)
        raise SystemExit(130) from None
    finally:
        watch.end()
        shown.clear()
    # names in an archive are anybody's
    print(json_text(came["facts"]) if as_json else visible_lines(came["text"]))
