"""`twin runs`: what lies in results/, and what of it may go."""

import sys
from pathlib import Path
from typing import Annotated

import typer

from twin.cli.ask import ask
from twin.cli.options import AsJson
from twin.errors import InputRefused, visible_lines


def runs(
    experiments: Annotated[
        list[str] | None, typer.Argument(metavar="EXPERIMENT", help="Only runs of these; none: all.")
    ] = None,
    results: Annotated[Path, typer.Option(metavar="DIR", help="Where they are.")] = Path("results"),
    prune: Annotated[
        bool, typer.Option("--prune", help="List old runs, and remove them once you have said yes.")
    ] = False,
    keep: Annotated[
        int, typer.Option(metavar="N", min=0, help="Of --prune; so many of each experiment stay, the newest.")
    ] = 1,
    yes: Annotated[bool, typer.Option("--yes", help="Of --prune; do not ask.")] = False,
    as_json: AsJson = False,
) -> None:
    """List the runs that are kept: when, size, verdict, what differs from the file now.

    Under a run stands with which options it was made, and what of its experiment
    has changed since. The newest stands first; latest is the run that
    results/EXPERIMENT means in other commands.
    Exit code: 0 listed or removed, 2 refused, 3 a run could not be removed.

    Example: twin runs
    """
    if not prune:
        if yes or keep != 1:
            raise InputRefused("twin runs: --keep and --yes belong to --prune; add that, or leave them out")
        ask("twin.studies.results.study:listed", {"results": results, "experiments": experiments or []}, as_json)
        return
    if as_json:
        raise InputRefused("twin runs: --prune asks and tells in words; leave --json out")
    from twin.studies.results.study import doomed_runs, doomed_text, removed

    doomed = doomed_runs(results, experiments or [], keep)
    if not doomed:
        print(f"{results}: nothing to remove; each experiment has {keep} at most")
        return
    print(visible_lines(doomed_text(doomed)))
    if not yes and not sys.stdin.isatty():
        print("nothing removed; --yes removes them")
    elif yes or typer.confirm("Remove them?", err=True):
        print(removed(doomed))
    else:
        print("nothing removed")
