"""`twin runs`: list and remove stored runs."""

import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Annotated

from twin.kernel.errors import InputRefused
from twin.studies.command import Answer, Argument, AsJson, Option, Say, confirm, study


@study()
def runs(
    say: Say,
    experiments: Annotated[Sequence[str], Argument("Only runs of these experiments; default: all.", "EXPERIMENT")] = (),
    results: Annotated[Path, Option("Where they are.", "DIR")] = Path("results"),
    prune: Annotated[bool, Option("List old runs and remove them after confirmation.")] = False,
    keep: Annotated[int, Option("With --prune: number of newest runs to keep per experiment.", "N", least=0)] = 1,
    yes: Annotated[bool, Option("With --prune: do not ask.")] = False,
    as_json: AsJson = False,
) -> Iterator[Answer]:
    """List stored runs: time, size, verdict, differences from the experiment's file now.

    Each run is listed with its options and with later changes of its
    experiment, newest first; latest is the run that results/EXPERIMENT means
    in other commands. Exit code: 0 listed or removed, 2 refused, 3 a run could
    not be removed.

    Example: twin runs
    """
    if not prune and (yes or keep != 1):
        raise InputRefused("twin runs: --keep and --yes belong to --prune; add that, or leave them out")
    if prune and as_json:
        raise InputRefused("twin runs: --prune asks questions; leave --json out")
    from twin.studies.results.stored import list_runs, removable_runs, removal_text, remove_runs

    if not prune:
        yield list_runs(results, experiments, say)
        return
    doomed = removable_runs(results, experiments, keep)
    if not doomed:
        yield Answer(f"{results}: nothing to remove; each experiment has {keep} at most", {})
        return
    yield Answer(removal_text(doomed), {})
    if not yes and not sys.stdin.isatty():
        yield Answer("nothing removed; --yes removes them", {})
    elif yes or confirm("Remove them?"):
        yield Answer(remove_runs(doomed), {})
    else:
        yield Answer("nothing removed", {})
