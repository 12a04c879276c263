"""Runs that are kept: listed as text, and removed if nobody needs them."""

import shlex
from collections.abc import Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import Any

from twin.kernel.errors import disk_refusals
from twin.kernel.recording.folder import LATEST
from twin.studies.answer import Answer
from twin.studies.lines import counted, cut, wrapped
from twin.studies.results.kept import ExperimentsNow, KeptRun, kept_runs, other_folders, told_differences
from twin.studies.steps import Say, Steps

FEW = 4
"""Differences that are told of a run; `--json` has all of them."""
LONG = 40
"""Characters of a value that are told; a list of way points says nothing in a line."""
INDENT = " " * 6

Differences = Mapping[str, tuple[str, str]]


def runs_text(
    results: Path, runs: Sequence[KeptRun], differences: Sequence[tuple[Differences, str]], others: Mapping[str, int]
) -> str:
    """How much there is, then run by run, the newest of each experiment first."""
    if not runs:
        return f"{results}: no runs; the first: twin run fig4_force_position"
    experiments = len({run.experiment for run in runs})
    total = size_text(sum(run.size for run in runs))
    lines = [f"{results}: {counted(len(runs), 'run')} of {counted(experiments, 'experiment')}, {total}"]
    last = ""
    for run, (found, why) in zip(runs, differences, strict=True):
        if run.experiment != last:
            lines += ["", run.experiment]
            last = run.experiment
        lines += [*run_lines(run), *difference_lines(found, why)]
    if others:
        said = ", ".join(f"{name} {size_text(size)}" for name, size in others.items())
        lines += ["", *wrapped(f"also there: {said}", later=2)]
    return "\n".join(lines)


def run_lines(run: KeptRun) -> list[str]:
    """When, size, verdict, and the options with which it was made."""
    latest = "  latest" if run.latest else ""
    made = wrapped(shlex.join(run.typed), f"{INDENT}with ", whole=True) if run.typed else []
    return [f"  {run.folder.name:17}  {size_text(run.size):>7}  {verdict(run)}{latest}", *made]


def verdict(run: KeptRun) -> str:
    """What it came to, in a few words."""
    if not run.finished:
        return f"not finished: ends at {run.reached:.3g} s"
    told = []
    if run.summary.get("trip"):
        told.append("safety trip")
    elif any(level in ("ERROR", "FATAL") for _, level, _ in _events(run.summary)):
        told.append("failed")
    outcome = run.summary.get("outcome")
    if isinstance(outcome, dict):
        peak, error = outcome.get("peak"), outcome.get("force_error")
        told += [f"{peak:.2f} N at most" if peak > 0.0 else "never touched"] if isinstance(peak, float) else []
        told += [f"{error:.2f} N rms off"] if isinstance(error, float) else []
    return ", ".join(told) or "finished"


def difference_lines(differences: Differences, why: str) -> list[str]:
    """What another run of the same would do otherwise by now; nothing if it would not."""
    if why:
        return wrapped(f"not compared with its file: {why}", INDENT, later=8)
    lines = []
    for key, (then, now) in list(differences.items())[:FEW]:
        lines += wrapped(f"{key} was {cut(then, LONG)}, is {cut(now, LONG)} now", INDENT, later=8, whole=True)
    more = len(differences) - FEW
    return [*lines, *([f"{INDENT}and {counted(more, 'more difference')}"] if more > 0 else [])]


def size_text(size: float) -> str:
    """`7.0 MB`."""
    for unit in ("B", "kB", "MB", "GB"):
        if size < 1000.0 or unit == "GB":
            return f"{size:.0f} {unit}" if unit == "B" else f"{size:.1f} {unit}"
        size /= 1000.0
    raise AssertionError


def _events(summary: Mapping[str, Any]) -> list[tuple[Any, Any, Any]]:
    events = summary.get("events")
    listed = events if isinstance(events, list) else []
    return [(one[0], one[1], one[2]) for one in listed if isinstance(one, list) and len(one) == 3]


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
