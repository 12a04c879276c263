"""`twin report`: runs as one HTML page."""

import json
from pathlib import Path
from typing import Annotated

import typer


def report(
    runs: Annotated[
        list[Path],
        typer.Argument(metavar="RUN...", help="A run's folder, its .mcap file, or results/EXPERIMENT for the latest."),
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="The page; without it report.html beside the run, of several results/report."),
    ] = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")] = False,
) -> None:
    """Write a run, or several side by side, as one HTML page to look at offline.

    Exit code: 0 written, whatever the verdict, 2 input refused.

    Example: twin report results/fig4_force_position results/fig4_position
    """
    from twin.report.page.page import write_report

    done = write_report(runs, out)
    if as_json:
        print(json.dumps({"headline": done.headline, "page": str(done.path)}))
    else:
        print(f"{done.headline}\n  page  {done.path}")
