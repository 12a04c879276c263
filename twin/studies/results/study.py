"""Runs that are kept: listed, and those that nobody needs taken away."""

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

from twin.errors import disk_refusals
from twin.recording.folder import LATEST
from twin.studies.answer import Answer
from twin.studies.lines import counted
from twin.studies.results.kept import KeptRun, kept_runs, other_folders
from twin.studies.results.now import ExperimentsNow, told_differences
from twin.studies.results.text import run_lines, runs_text, size_text, verdict
from twin.studies.steps import Say, Steps

MANY = 10
"""So many files that stay are told."""


def listed(results: Path, experiments: Sequence[str], say: Say) -> Answer:
    """What lies in `results`.

    Args:
        results: folder.
        experiments: only runs of these; empty: all, and what else is there.
        say: told what is being read.

    Raises:
        InputRefused: no run is of one of `experiments`.
    """
    runs, now = kept_runs(results, experiments), ExperimentsNow()
    found = []
    steps = Steps(say, len(runs))
    for run in runs:
        steps.next(run.experiment)
        found.append(told_differences(run, now))
    others = {} if experiments else other_folders(results)
    facts = {
        "results": str(results),
        "runs": [
            {
                "folder": str(run.folder),
                "experiment": run.experiment,
                "latest": run.latest,
                "finished": run.finished,
                "bytes": run.size,
                "verdict": verdict(run),
                "outcome": run.summary.get("outcome"),
                "with": run.typed,
                "changed_since": {key: {"then": then, "now": now} for key, (then, now) in differences.items()},
                "not_compared": why,
            }
            for run, (differences, why) in zip(runs, found, strict=True)
        ],
        "others": others,
    }
    return Answer(runs_text(results, runs, found, others), facts)


def doomed_runs(results: Path, experiments: Sequence[str], keep: int) -> list[KeptRun]:
    """The runs of each experiment but the newest `keep`, and but the one that its folder means by `latest`.

    A run that its user has given a name stays, and does not count.

    Raises:
        InputRefused: no run is of one of `experiments`.
    """
    seen: dict[str, int] = {}
    doomed = []
    for run in kept_runs(results, experiments):
        if run.named:
            continue
        seen[run.experiment] = seen.get(run.experiment, 0) + 1
        if seen[run.experiment] > keep and not (keep and run.latest):
            doomed.append(run)
    return doomed


def doomed_text(doomed: Sequence[KeptRun]) -> str:
    """What would go."""
    lines = [f"{counted(len(doomed), 'run')}, {size_text(sum(run.size for run in doomed))}, would go:"]
    for experiment, runs in groupby(doomed, lambda run: run.experiment):
        lines += [experiment, *(line for run in runs for line in run_lines(run))]
    return "\n".join([*lines, *_staying(doomed)])


def removed(doomed: Sequence[KeptRun]) -> str:
    """Take the folders of `doomed` away; what has become of them.

    Raises:
        NotWritten: one cannot be removed.
    """
    size = 0
    others = sum(len(run.others) for run in doomed)
    for run in doomed:
        with disk_refusals(run.folder, "cannot be removed"):
            size += run.remove()
            latest = run.folder.parent / LATEST
            if run.latest and latest.is_symlink():
                latest.unlink()
            if not any(run.folder.parent.iterdir()):
                run.folder.parent.rmdir()
    stays = f"; {counted(others, 'file')} that twin did not write stayed" if others else ""
    return f"removed {counted(len(doomed), 'run')}, {size_text(size)}{stays}"


def _staying(doomed: Sequence[KeptRun]) -> list[str]:
    """What lies in the folders of `doomed` and is not twin's."""
    kept = [str(path) for run in doomed for path in run.others]
    more = [f"  and {len(kept) - MANY} more"] if len(kept) > MANY else []
    return ["stays, because twin did not write it:", *(f"  {path}" for path in kept[:MANY]), *more] if kept else []
