"""What was looked at, and how it is."""

from collections.abc import Sequence
from typing import Literal, NamedTuple

State = Literal["ok", "note", "lacks", "bad"]
"""note: only who develops twin misses it. lacks: it runs, without something. bad: it does not run."""


class Finding(NamedTuple):
    """One thing that was looked at; `text` says what to do where it is not ok."""

    topic: str
    state: State
    text: str


def is_ready(findings: Sequence[Finding]) -> bool:
    """Whether experiments run."""
    return all(finding.state != "bad" for finding in findings)


def lacking(findings: Sequence[Finding]) -> list[str]:
    """The topics without which it is ready."""
    return [finding.topic for finding in findings if finding.state == "lacks"]
