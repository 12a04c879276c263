"""What differs between what two trees came to, said so that one knows where to look."""

import difflib
from typing import Any

from tests.bytes.normal import DRAWN_OF_DURATIONS, normal, normal_error
from tests.bytes.outputs import ERROR
from tests.bytes.recording import SHORT

ROWS = "rows.jsonl"
LINES = 12
"""Lines of two texts that are shown."""
MISSING = "nothing"


def differences(before: dict[str, Any], after: dict[str, Any]) -> list[str]:
    """A sentence per part of a case that is not the same, with the lines of its texts that differ."""
    ours, theirs = _normal(before), _normal(after)
    return [
        f"{name}: {_difference(ours.get(name, MISSING), theirs.get(name, MISSING))}"
        for name in dict.fromkeys([*ours, *theirs])
        if ours.get(name, MISSING) != theirs.get(name, MISSING)
    ]


def _normal(came_to: dict[str, Any]) -> dict[str, Any]:
    """The same without what may differ, in names of files either."""
    found: dict[str, Any] = {}
    for name, value in came_to.items():
        if isinstance(value, str):
            value = normal_error(value) if name.endswith(ERROR) else normal(value)
        place = normal(name)
        # a sweep writes its rows as runs end
        if place.endswith(ROWS) and isinstance(value, str):
            value = "\n".join(sorted(value.splitlines()))
        if place.endswith(DRAWN_OF_DURATIONS):
            continue
        # two runs of one case that were made at other moments
        while place in found:
            place += " again"
        found[place] = value
    return found


def _difference(before: Any, after: Any) -> str:
    if isinstance(before, dict) and isinstance(after, dict):
        return _of_topics(before, after)
    if isinstance(before, dict) or isinstance(after, dict):
        return "recorded in only one of the trees"
    lines = list(difflib.unified_diff(before.splitlines(), after.splitlines(), "before", "after", lineterm="", n=0))[2:]
    more = [f"... {len(lines) - LINES} lines more"] if len(lines) > LINES else []
    shown = [line if len(line) < 200 else f"{line[:200]}..." for line in lines[:LINES]]
    return "".join(f"\n    {line}" for line in [*shown, *more]) or "the ends of lines differ"


def _of_topics(before: dict[str, Any], after: dict[str, Any]) -> str:
    said = []
    if before["messages"] != after["messages"]:
        said.append(f"{before['messages']} messages before, {after['messages']} after")
    ours, theirs = _seconds(before), _seconds(after)
    part = [second for second, (one, other) in enumerate(zip(ours, theirs, strict=False)) if one != other]
    if part:
        said.append(f"{len(part)} of {len(ours)} seconds differ, first from {part[0]} s to {part[0] + 1} s")
    return "; ".join(said) or "the same until one of them ends"


def _seconds(topic: dict[str, Any]) -> list[str]:
    digits = topic["seconds"]
    return [digits[at : at + SHORT] for at in range(0, len(digits), SHORT)]
