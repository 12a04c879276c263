"""`twin report`: runs as one HTML page."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from twin.cli.job import finished
from twin.cli.options import JOB_ISOLATION, AsJson, Isolate, JobIsolation
from twin.cli.progress import progress
from twin.errors import InputRefused, plain
from twin.runs.guard.remains import seen_from_here
from twin.writing import json_text

Listener = Callable[[dict[str, Any]], None]
"""Takes a note of `twin.runs.guard.runs.recorded_runs`."""


def report(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN...", help="A run's folder, its .mcap file, or results/EXPERIMENT for the latest."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE", help="The page; without it report.html beside the run, of several in results/report."
        ),
    ] = None,
    budget: Annotated[
        bool, typer.Option("--budget", help="Run it again without its imperfections: what adds to the force error.")
    ] = False,
    as_json: AsJson = False,
    isolate: Isolate = JOB_ISOLATION,
) -> None:
    """Write a run, or several side by side, as one HTML page to look at offline.

    Exit code: 0 written, whatever the verdict, 2 input refused, 3 a component
    failed while a budget was made.

    Example: twin report results/fig4_force_position results/fig4_position
    """
    shown = progress()
    arguments: dict[str, Any] = {
        "runs": [str(run) for run in runs],
        "out": None if out is None else str(out),
        "budget": budget,
    }
    try:
        # without a budget no FMU is loaded
        page, headline = finished(reported, arguments, isolate if budget else JobIsolation.NONE, shown.say)
    finally:
        shown.clear()
    _tell(Path(page), headline, as_json)


def reported(voice: Any, runs: list[str], out: str | None, budget: bool) -> tuple[str, str]:
    """(page, headline); a job of the guard."""
    from twin.report.page.page import write_report

    file = None if out is None else Path(out)
    done = write_report([Path(run) for run in runs], file, budget, lambda what: voice.note(say=what))
    return str(done.path), done.headline


class Reported:
    """Writes one page on all runs when they are over, also if one of them did not end well.

    Args:
        wanted: whether to. as_json: tell it as JSON.
    """

    def __init__(self, wanted: bool, as_json: bool):
        self._wanted = wanted
        self._as_json = as_json
        self._folders: list[Path] = []

    def noting(self, listener: Listener) -> Listener:
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
            done = write_report(recorded)
            _tell(done.path, done.headline, self._as_json)
        except InputRefused as problem:
            if kind is None:
                raise
            # why the run itself ended is what the user has to hear last
            print(plain(str(problem)), file=sys.stderr)


def _tell(path: Path, headline: str, as_json: bool) -> None:
    page = seen_from_here(path)
    if as_json:
        print(json_text({"headline": headline, "page": str(page)}))
    else:
        print(f"{headline}\n  page  {page}")
