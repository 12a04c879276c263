"""`twin report`: runs as one HTML page."""

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer

from twin.cli.ask import ask, show
from twin.cli.options import JOB_ISOLATION, AsJson, Isolate, JobIsolation
from twin.errors import InputRefused, plain
from twin.studies.first_look import print_latest

Listener = Callable[[dict[str, Any]], None]
"""Takes a note of `twin.runs.guard.runs.recorded_runs`."""


def report(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN", help="A run's folder, its .mcap file, or results/EXPERIMENT for the latest."),
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
    print_latest({"runs": runs})
    asked: dict[str, Any] = {"runs": runs, "out": out, "budget": budget}
    # without a budget no FMU is loaded
    ask("twin.report.page.page:write_report", asked, as_json, isolate if budget else JobIsolation.NONE)


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
            show(write_report(recorded), self._as_json)
        except InputRefused as problem:
            if kind is None:
                raise
            # why the run itself ended is what the user has to hear last
            print(plain(str(problem)), file=sys.stderr)
