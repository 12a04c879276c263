"""Text of a hazard table's lines, at most 80 columns wide, and regressions against an older page."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from twin.kernel.errors import InputRefused
from twin.studies.result import Block, Column, Note, Result, Table, count_text
from twin.studies.safety.evidence import GOOD_STATUSES, HazardLine
from twin.studies.safety.page import magnitude_ranges, seen_text, worst_texts

LINE_COLUMNS = (
    Column("", 4, left=True),
    Column("hazard", 22, ".22s", left=True),
    Column("limit", 8),
    Column("worst", 8),
    Column("ideal", 8),
    Column("without", 8),
    Column("detected", 8),
    Column("", left=True),
)
PEAK_RATIO = 1.05
"""Minimum ratio of a higher peak to the old one."""
MIN_PEAK_GROWTH = 0.5
"""Minimum growth of a higher peak (N): rounding of processors is less."""


def lines_table(lines: Sequence[HazardLine]) -> Table:
    """Format the lines as a table: limit, worst run with monitor, ideal one and without, detected runs, status."""
    rows = []
    for line in lines:
        words, limit = line.hazard.table, line.hazard.limit_text.rpartition(" of ")[2]
        seen = seen_text(line).replace(" of ", "/")
        rows.append((words.id, words.hazard, limit, *worst_texts(line), seen, line.status))
    return Table(LINE_COLUMNS, rows, indent=0)


def failures(lines: Sequence[HazardLine]) -> list[Block]:
    found: list[Block] = []
    for line in lines:
        if line.failed_runs:
            run = line.failed_runs[0]
            reason = (run.failure.splitlines() or ["no reason was given"])[0]
            count = count_text(len(line.failed_runs), "run")
            found.append(Note(f"{line.hazard.table.id}: {count} failed; {run.cause} on {run.body}: {reason}", later=4))
    return ["", *found] if found else []


def verdict(
    lines: Sequence[HazardLine], facts: Mapping[str, Any], parts: Sequence[Block], files: Mapping[str, object]
) -> Result:
    """Create the report of `twin safety`: verdict on all hazard lines, values for JSON, and files."""
    good_count, stated_count = (
        sum(line.status in statuses for line in lines) for statuses in (GOOD_STATUSES, ("exceeded as stated",))
    )
    bad = len(lines) - good_count - stated_count
    failed = bad > 0 or bool(facts["worse"])
    text = (
        f"{'FAILED' if failed else 'as stated'}: {good_count} of {len(lines)} lines kept, {stated_count} "
        f"exceeded as stated, {bad} exceeded or failed. This complies with no standard by itself."
    )
    ranges = Note(f"Magnitudes: {'; '.join(magnitude_ranges([line.hazard for line in lines]))}.", later=4)
    return Result(Note(text, later=4), [*parts, ranges, ""], dict(facts), files, exit_code=int(failed))


def old_lines(path: Path) -> dict[str, dict[str, Any]]:
    """Load the lines of an older safety page's data, by their ids."""
    try:
        found = json.loads(path.read_text())
        return {line["id"]: line for line in found["lines"]}
    except OSError as problem:
        raise InputRefused(f"--against {path}: {problem.strerror or problem}") from None
    except (ValueError, KeyError, TypeError):
        raise InputRefused(f"--against {path}: not the data of twin safety; expected its safety.json") from None


def regressions(old: Mapping[str, Mapping[str, Any]], lines: Sequence[Mapping[str, Any]]) -> Iterator[str]:
    """Yield a sentence for each hazard line that became worse than in the older page, or is missing now."""
    new = {line["id"]: line for line in lines}
    for name, before in old.items():
        after = new.get(name)
        if after is None:
            yield f"{name}: the line is gone"
            continue
        if before["status"] in GOOD_STATUSES and after["status"] not in GOOD_STATUSES:
            yield f"{name}: {after['status']}, was kept"
        elif after["status"] == "failed" and before["status"] != "failed":
            yield f"{name}: a run failed"
        for of, seen, made in ((None, "detected", "runs"), ("drawn", "count", "of")):
            was, now = (line if of is None else line.get(of) for line in (before, after))
            if was and now and now[made] and was[made] and now[seen] / now[made] < was[seen] / was[made]:
                what = "" if of is None else f" {of} runs"
                yield f"{name}: {now[seen]} of {now[made]}{what} seen, were {was[seen]} of {was[made]}"
        was, now = before["peak_N"], after["peak_N"]
        if was is not None and now is not None and now > PEAK_RATIO * was and now > was + MIN_PEAK_GROWTH:
            yield f"{name}: peak {now:.1f} N, was {was:.1f} N"
