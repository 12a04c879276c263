"""`twin run`: experiments in, recordings out."""

import json
import math
import os
import sys
import textwrap
from collections.abc import Callable
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from twin.cli.report import Listener, Reported
from twin.errors import ComponentFailed, InputRefused
from twin.guard.guard import GRACE, JobDied, guarded
from twin.guard.limits import Limits
from twin.guard.remains import remains, seen_from_here

JOB = "twin.guard.runs:recorded_runs"


class Isolation(StrEnum):
    """What lives in a process of its own."""

    RUN = "run"
    DRIVE = "drive"
    NONE = "none"


def run(
    experiments: Annotated[list[Path], typer.Argument(metavar="EXPERIMENT...", help="Experiment files (TOML).")],
    drive: Annotated[
        str | None, typer.Option(metavar="FMU", help="Drive of every joint: an .fmu file, or a drive of fmus/.")
    ] = None,
    body: Annotated[
        str | None, typer.Option(metavar="BODY", help="What to press on: a file of experiments/bodies/, such as back.")
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a value of the experiment.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="The run's own folder; without it, results/EXPERIMENT/TIME.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object per run instead of text.")] = False,
    report: Annotated[bool, typer.Option("--report", help="Then write an HTML page, as twin report does.")] = False,
    isolate: Annotated[
        Isolation,
        typer.Option(help="Processes: one for the run; one for each drive besides; none, for debuggers, but this one."),
    ] = Isolation.RUN if os.name == "posix" else Isolation.NONE,
    limit_step: Annotated[
        float, typer.Option(metavar="S", min=0.0, help="Longest time of one call into a drive.")
    ] = 10.0,
    limit_wall: Annotated[
        float, typer.Option(metavar="S", min=0.0, help="Longest time of the whole command.")
    ] = math.inf,
    limit_memory: Annotated[
        float, typer.Option(metavar="MB", min=0.0, help="Most memory of the run's process.")
    ] = 4000.0,
) -> None:
    """Run experiments and record them.

    Exit code: 0 done, 3 a component failed while running (error, crash, hang),
    2 input refused (also an FMU that crashes before the first step), 4 the safety
    monitor tripped although the experiment has no faults, 130 interrupted.
    """
    if out is not None and len(experiments) > 1:
        raise InputRefused(f"--out {out}: names the folder of one run; {len(experiments)} experiments were given")
    if isolate != Isolation.NONE and os.name != "posix":
        raise InputRefused(f"--isolate {isolate}: needs Linux or macOS; use --isolate none here")
    arguments = {
        "experiments": [str(path) for path in experiments],
        "settings": settings or [],
        "drive": drive,
        "body": body,
        "out": str(out) if out else None,
        "isolate_drives": isolate == Isolation.DRIVE,
        "limit_step": limit_step,
    }
    with Reported(report, as_json) as reported, Display(as_json) as display:
        hear = reported.noting(display.hear)
        try:
            if isolate == Isolation.NONE:
                _run_here(arguments, hear, display.show)
            else:
                # the run itself notices a drive of its own that is stuck, and ends better than if it is ended
                patience = limit_step + (GRACE if isolate == Isolation.DRIVE else 0.0)
                limits = Limits(patience, limit_wall, 1e6 * limit_memory)
                guarded(JOB, arguments, limits, hear, display.show)
        except JobDied as death:
            raise ComponentFailed(f"{death}\n{remains(display.folder)}") from None
        except KeyboardInterrupt:
            if display.folder is None:
                raise
            folder = seen_from_here(display.folder)
            print(f"interrupted; recorded until then: {folder}/run.mcap.partial", file=sys.stderr)
            raise SystemExit(130) from None


def _run_here(arguments: dict[str, Any], hear: Listener, show: Callable[[int, int], None]) -> None:
    from twin.guard.runs import recorded_runs
    from twin.guard.voice import DirectVoice

    recorded_runs(DirectVoice(hear, show), **arguments)


class Display:
    """A progress bar on a terminal, and what each run has to say when it is done.

    Attributes:
        folder: of the run that is on, None before the first.
    """

    def __init__(self, as_json: bool):
        self.folder: Path | None = None
        self._name = ""
        self._as_json = as_json
        self._bar: Any = None
        if not as_json and sys.stdout.isatty():
            from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

            self._bar = Progress(
                TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"),
                TimeRemainingColumn(), transient=True,
            )  # fmt: skip
            self._task = self._bar.add_task("loading", total=1.0)

    def __enter__(self) -> "Display":
        if self._bar:
            self._bar.start()
        return self

    def __exit__(self, *failure: object) -> None:
        if self._bar:
            self._bar.stop()

    def hear(self, note: dict[str, Any]) -> None:
        """Take a note of `recorded_runs`."""
        if "run" in note:
            facts = {"experiment": self._name, **note["run"]}
            facts["recording"] = seen_from_here(Path(facts["recording"]))
            told = json.dumps(_facts(facts)) if self._as_json else _sentence(facts)
            (self._bar.console.print if self._bar else print)(told)
        else:
            self._name, self.folder = note["experiment"], Path(note["folder"])
            if self._bar:
                self._bar.update(self._task, description=self._name, completed=0.0)

    def show(self, done: int, total: int) -> None:
        """Move the bar."""
        if self._bar:
            self._bar.update(self._task, completed=done / total)


def _sentence(run: dict[str, Any]) -> str:
    lines = [f"{run['experiment']}  {run['simulated']:g} s at {run['real_time_factor']:.0f} x real time"]
    for t, level, text in run["events"]:
        if level != "DEBUG":
            lines += textwrap.wrap(f"{t:8.3f} s  {text}", 80, subsequent_indent=" " * 12)
    for drive in dict.fromkeys(run["drives"]):
        head, *rest = drive.splitlines()
        lines += [
            f"  drive {head}",
            *(part for line in rest for part in textwrap.wrap(line, 72, initial_indent="    ")),
        ]
    return "\n".join([*lines, f"  {run['recording']}"])


def _facts(run: dict[str, Any]) -> dict[str, object]:
    return {
        "experiment": run["experiment"],
        "recording": str(run["recording"]),
        "simulated_s": run["simulated"],
        "stepping_s": run["stepping"],
        "recording_s": run["writing"],
        "real_time_factor": run["real_time_factor"],
        "drives": list(run["drives"]),
        "trip": run["trip"],
        "events": [{"t_s": t, "level": level, "text": text} for t, level, text in run["events"]],
    }
