"""`twin run`: experiments in, recordings out."""

import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

from twin.cli.ahead import JOB
from twin.cli.ask import Hear, recorded
from twin.cli.streams import show
from twin.cli.terminal import TerminalDisplay
from twin.kernel.errors import InputRefused, plain
from twin.kernel.process.guard import GRACE
from twin.kernel.process.job import LONG, JobLimits
from twin.studies.command import (
    JOB_ISOLATION,
    Argument,
    BodyName,
    DriveName,
    Isolation,
    LimitStep,
    LimitWall,
    Option,
    Settings,
    study,
)

LIVE_JOB = "twin.robot.live.runs:served_runs"
PORT = 8765
MEMORY = 4000.0


@study(json=False)
def run(
    experiments: Annotated[
        Sequence[Path], Argument("Experiment files (TOML), or names.", "EXPERIMENT", complete="experiment")
    ] = (),
    drive: DriveName = None,
    body: BodyName = None,
    settings: Settings = (),
    ranges: Annotated[
        Sequence[str],
        Option("Run once per value, like twin sweep; writes rows, no recordings.", "KEY=FROM:TO:COUNT", "--sweep"),
    ] = (),
    start_from: Annotated[
        str | None, Option("Go on from a state of a run; with --set, only duration_s.", "RUN[@SECONDS]", "--from")
    ] = None,
    out: Annotated[Path | None, Option("Folder of the run; default: results/EXPERIMENT/TIME.", "DIR")] = None,
    as_json: Annotated[bool, Option("Print one JSON object per run instead of text.", flags="--json")] = False,
    report: Annotated[bool, Option("Also write an HTML page, like twin report.")] = False,
    isolate: Annotated[
        Isolation,
        Option("Processes: one for the run, one more per drive, or none (for debuggers)."),
    ] = Isolation(JOB_ISOLATION),  # noqa: B008, it is a constant
    limit_step: LimitStep = JobLimits.step,
    limit_wall: LimitWall = math.inf,
    limit_memory: Annotated[float, Option("Most memory of the run's process.", "MB", least=0.0)] = MEMORY,
    live: Annotated[bool, Option("Serve the run to Lichtblick or Foxglove; starts with the first viewer.")] = False,
    port: Annotated[int, Option("With --live: port; 0: any free one.", "N", least=0, most=65535)] = PORT,
    origins: Annotated[
        Sequence[str],
        Option("With --live: also allow pages from this origin, https://host:port.", "ORIGIN", "--origin"),
    ] = (),
    realtime: Annotated[
        float | None,
        Option("Speed as a multiple of real time; 0: as fast as possible; with --live: 1.", "[=FACTOR]", least=0.0),
    ] = None,
    yes: Annotated[bool, Option("Allow runs of more than an hour or 5 GB.")] = False,
) -> None:
    """Run experiments and record them.

    Exit code: 0 done, 3 a component failed while running (error, crash, hang),
    2 input refused (also an FMU that crashes before the first step), 4 the
    safety monitor tripped although the experiment has no faults, 130
    interrupted, 143 terminated.

    Example: twin run experiments/fig4_force_position.toml --drive pmsm_foc
    """
    if ranges:
        others = (body, report, live, realtime is not None, isolate != Isolation.RUN, limit_wall < math.inf)
        if len(experiments) > 1 or any(others) or limit_memory != MEMORY:
            raise InputRefused(
                "--sweep: takes one experiment and --drive, --set, --out, --limit-step, --json; "
                "for more, write a sweep file for twin sweep"
            )
        from twin.studies.sweep.study import short_sweep

        with TerminalDisplay(loading=False) as display:
            answer = short_sweep(experiments[0], ranges, drive, settings, out, limit_step, as_json, yes, display.say)
        show(answer, as_json)
        raise SystemExit(answer.exit_code)
    if not experiments and start_from is None:
        raise InputRefused("twin run: missing argument 'EXPERIMENT'; see twin run --help")
    if start_from is not None and (experiments or drive is not None or body is not None):
        raise InputRefused("--from: the run says its experiment, drive and body; leave them out, or use twin branch")
    if out is not None and len(experiments) > 1:
        raise InputRefused(f"--out {out}: names the folder of one run; {len(experiments)} experiments were given")
    if isolate != Isolation.NONE and os.name != "posix":
        raise InputRefused(f"--isolate {isolate}: needs Linux or macOS; use --isolate none here")
    if realtime is not None and not math.isfinite(realtime):
        raise InputRefused(f"--realtime={realtime}: expected a finite factor; 0 runs as fast as it goes")
    factor = realtime if realtime is not None or not live else 1.0
    arguments: dict[str, Any] = {
        "experiments": [str(path) for path in experiments],
        "settings": settings,
        "drive": drive,
        "body": body,
        "out": str(out) if out else None,
        "isolate_drives": isolate == Isolation.DRIVE,
        "limit_step": limit_step,
        "factor": factor,
        "sure": yes,
        "start_from": start_from,
        **({"port": port, "origins": origins} if live else {}),
    }
    # the run itself notices a drive of its own that is stuck, and ends better than if it is ended
    patience = limit_step + (GRACE if isolate == Isolation.DRIVE else 0.0)
    # a paced run lasts as long as it was asked to
    limits = JobLimits(patience, limit_wall, 1e6 * limit_memory, math.inf if yes or factor else LONG)
    with Reported(report, as_json) as reported, TerminalDisplay(as_json) as display:
        recorded(LIVE_JOB if live else JOB, arguments, display, isolate, limits, reported.noting(display.hear))


class Reported:
    """Writes one page on all runs when they are over, also if one of them did not end well.

    Args:
        wanted: whether to.
        as_json: tell it as JSON.
    """

    def __init__(self, wanted: bool, as_json: bool):
        self._wanted = wanted
        self._as_json = as_json
        self._folders: list[Path] = []

    def noting(self, listener: Hear) -> Hear:
        """`listener`, and the folders of the runs are kept in mind."""

        def hear(note: dict[str, Any]) -> None:
            if "folder" in note:
                self._folders.append(Path(note["folder"]))
            listener(note)

        return hear

    def __enter__(self) -> "Reported":
        return self

    def __exit__(self, kind: type[BaseException] | None, *failure: object) -> None:
        recorded = [folder for folder in self._folders if any(folder.glob("*.mcap*"))]
        if not self._wanted or not recorded:
            return
        from twin.report.page.page import write_report

        try:
            show(write_report(recorded), self._as_json)
        except InputRefused as problem:
            if kind is None:
                raise
            # why the run itself ended is what the user has to hear last
            print(plain(str(problem)), file=sys.stderr)
