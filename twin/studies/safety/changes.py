"""Regressions of a safety page against an older page."""

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from twin.kernel.errors import InputRefused

PEAK_RATIO = 1.05
"""Minimum ratio of a higher peak to the old one."""
MIN_PEAK_GROWTH = 0.5
"""Minimum growth of a higher peak (N): rounding of processors is less."""


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
        if before["status"] == "kept" and after["status"] != "kept":
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
