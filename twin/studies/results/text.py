"""What lies in results/, as text of at most 80 columns."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from twin.studies.lines import counted, cut, wrapped
from twin.studies.results.kept import KeptRun

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
