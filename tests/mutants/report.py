"""What became of the mutants of one draw, kept line by line: a draw takes hours, and goes on where it was left."""

import json
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

Key = tuple[str, str, int]
"""File, operator and occurrence of a mutant."""

IN_ROOM = "survived its room"
"""Outcome of a mutant that is still to be tried against the laws."""


def commit_of(path: Path, draw: Mapping[str, Any]) -> str:
    """The commit of the draw that the record at `path` is of; "" if it is not of `draw`: seed, count and rooms."""
    first = _facts(path)[:1]
    if not first or {**first[0], **draw} != first[0]:
        return ""
    return str(first[0]["commit"])


class Report:
    """A file of which the first line says what was drawn, and each other one what became of a mutant.

    Args:
        path: of the file. What it says of another draw is replaced; a line that was cut off is left out.
        draw: what makes the draw: seed, count, rooms and commit.

    Attributes:
        outcomes: "killed", "timed out", which counts as killed, "survived" or `IN_ROOM`.
    """

    def __init__(self, path: Path, draw: Mapping[str, Any]):
        self._path, self.draw = path, dict(draw)
        self.outcomes: dict[Key, str] = {}
        self._lines: dict[Key, int] = {}
        for fact in self._kept():
            self._take(fact)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("".join(json.dumps(fact) + "\n" for fact in (self.draw, *map(self._fact, self.outcomes))))

    def note(self, key: Key, line: int, outcome: str) -> None:
        """Keep what became of a mutant at `line` of its file."""
        self._take({"file": key[0], "operator": key[1], "occurrence": key[2], "line": line, "outcome": outcome})
        with self._path.open("a") as file:
            file.write(json.dumps(self._fact(key)) + "\n")

    @property
    def killed(self) -> float:
        """Share of the mutants that a test noticed."""
        return 1.0 - sum(map(_is_alive, self.outcomes.values())) / max(1, len(self.outcomes))

    def text(self, possible: int, day: str) -> str:
        """The text of a draw for SURVIVORS.md: when it was made, of what, how many were killed, and a row per survivor.

        Args:
            possible: mutants that it was drawn from.
            day: on which it ended.
        """
        number = Counter(self.outcomes.values())
        total, alive = len(self.outcomes), sum(map(_is_alive, self.outcomes.values()))
        rooms = ", ".join(self.draw["rooms"]) if self.draw["rooms"] else "all rooms"
        head = (
            f"The {self.draw['count']} mutants of seed {self.draw['seed']} were drawn from {possible:,} in {rooms} at "
            f"commit {self.draw['commit'][:8]}, and {total} of them tried until {day}: {total - alive} were killed "
            f"({self.killed:.0%}), {number['timed out']} of them by taking too long, and {alive} survived; "
            f"{number[IN_ROOM]} of these are still to be tried against the laws."
        )
        rows = [
            f"| `{file}:{self._lines[file, operator, occurrence]}` | {operator.removeprefix('core/')} {occurrence} | |"
            for (file, operator, occurrence), outcome in sorted(self.outcomes.items())
            if _is_alive(outcome)
        ]
        return "\n".join([head, "", "| place | change | why |", "|---|---|---|", *rows])

    def _kept(self) -> list[dict[str, Any]]:
        """Facts of the mutants in the file, if it is of this draw."""
        draw, *found = _facts(self._path) or [{}]
        return found if draw == self.draw else []

    def _take(self, fact: Mapping[str, Any]) -> None:
        key = fact["file"], fact["operator"], fact["occurrence"]
        self.outcomes[key], self._lines[key] = fact["outcome"], fact["line"]

    def _fact(self, key: Key) -> dict[str, Any]:
        names = ("file", "operator", "occurrence")
        return {**dict(zip(names, key, strict=True)), "line": self._lines[key], "outcome": self.outcomes[key]}


def _is_alive(outcome: str) -> bool:
    return outcome in ("survived", IN_ROOM)


def _facts(path: Path) -> list[dict[str, Any]]:
    found = []
    for line in path.read_text().splitlines() if path.exists() else ():
        try:
            found.append(json.loads(line))
        except ValueError:
            # the last one, of a session that ended while it was written: its mutant is tried again
            continue
    return found
