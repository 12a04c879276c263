"""`twin run`: experiments in, recordings out."""

import json
import sys
import textwrap
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from twin.errors import InputRefused

if TYPE_CHECKING:
    from twin.execution import Run


def run(
    experiments: Annotated[list[Path], typer.Argument(metavar="EXPERIMENT...", help="Experiment files (TOML).")],
    drive: Annotated[
        str | None, typer.Option(metavar="FMU", help="Drive of every joint: an .fmu file, or a drive of fmus/.")
    ] = None,
    settings: Annotated[
        list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Override a value of the experiment.")
    ] = None,
    out: Annotated[
        Path | None, typer.Option(metavar="DIR", help="The run's own folder; without it, results/EXPERIMENT/TIME.")
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object per run instead of text.")] = False,
) -> None:
    """Run experiments and record them.

    Exit code: 0 done, 2 input refused, 3 a component failed while running, 130 interrupted.
    """
    if out is not None and len(experiments) > 1:
        raise InputRefused(f"--out {out}: names the folder of one run; {len(experiments)} experiments were given")
    from twin.execution import execute
    from twin.experiment.experiment import load_experiment
    from twin.recording.folder import claim_run_folder, create_run_folder

    loaded = [load_experiment(path, settings or [], drive) for path in experiments]
    for experiment in loaded:
        folder = (
            claim_run_folder(out) if out else create_run_folder(Path("results"), experiment.name, datetime.now())
        )
        with Display(experiment.name, quiet=as_json) as display:
            try:
                done = execute(experiment, folder, display.show)
            except KeyboardInterrupt:
                print(f"interrupted; recorded until then: {folder}/run.mcap.partial", file=sys.stderr)
                raise SystemExit(130) from None
        print(json.dumps(_facts(experiment.name, done)) if as_json else _sentence(experiment.name, done))


class Display:
    """A progress bar on a terminal, nothing elsewhere."""

    def __init__(self, name: str, quiet: bool):
        self._bar: Any = None
        if not quiet and sys.stdout.isatty():
            from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

            self._bar = Progress(
                TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:3.0f} %"),
                TimeRemainingColumn(), transient=True,
            )  # fmt: skip
            self._task = self._bar.add_task(name, total=1.0)

    def __enter__(self) -> "Display":
        if self._bar:
            self._bar.start()
        return self

    def __exit__(self, *failure: object) -> None:
        if self._bar:
            self._bar.stop()

    def show(self, done: int, total: int) -> None:
        if self._bar:
            self._bar.update(self._task, completed=done / total)


def _sentence(name: str, done: "Run") -> str:
    lines = [f"{name}  {done.simulated:g} s at {done.real_time_factor:.0f} x real time"]
    lines += [f"  {text} at t = {t:.3f} s" for t, text in done.events]
    for drive in dict.fromkeys(done.drives):
        head, *rest = drive.splitlines()
        lines += [f"  drive {head}", *(part for line in rest for part in textwrap.wrap(line, 72, initial_indent="    "))]
    return "\n".join([*lines, f"  {done.recording}"])


def _facts(name: str, done: "Run") -> dict[str, object]:
    return {
        "experiment": name,
        "recording": str(done.recording),
        "simulated_s": done.simulated,
        "stepping_s": done.stepping,
        "recording_s": done.writing,
        "real_time_factor": done.real_time_factor,
        "drives": list(done.drives),
        "events": [{"t_s": t, "text": text} for t, text in done.events],
    }
