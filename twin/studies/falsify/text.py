"""What the search found, as text of at most 80 columns and as facts."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.robot.experiment.fault import CATALOGUE
from twin.studies.falsify.space import Ended, Holes, Space, TriedFault
from twin.studies.faults.text import magnitude_text
from twin.studies.result import Block, Cell, Column, Note, Result, Table

COLUMNS = (
    Column("", 23, left=True),
    Column("distance", 10),
    Column("magnitude", 11),
    Column("onset", 8),
    Column("target", 15, left=True),
    Column("run", 4),
    Column(left=True),
)
SHOWN = 5
"""Kinds that do not violate, the nearest first."""


@dataclass(frozen=True)
class Requirement:
    """What is required: its name, its formula and the unit of its distance."""

    name: str
    formula: str
    unit: str


@dataclass(frozen=True)
class Found:
    """The nearest run of one kind.

    Attributes:
        wrong: what was wrong in it.
        distances: by the name of the requirement.
        share: the smallest of them as a share of the healthy one.
        run: its number, from 1.
        first: number of the first run of this kind that violated; None: none did.
        ended: why the run did not come to its end; None: it did.
    """

    wrong: TriedFault
    distances: dict[str, float]
    share: float
    run: int
    first: int | None
    ended: Ended | None = None

    def facts(self, space: Space) -> dict[str, Any]:
        """For JSON."""
        wrong = self.wrong
        return {
            "kind": wrong.kind,
            "target": wrong.target,
            CATALOGUE[wrong.kind].magnitude_key or "magnitude": wrong.magnitude,
            "onset_s": space.onset(wrong),
            "body": wrong.body,
            "seed": wrong.seed,
            "distances": self.distances,
            "share": self.share,
            "run": self.run,
            "first_violating_run": self.first,
            "ended": self.ended and self.ended.reason,
        }


def header(experiment: str, found: Found, requirements: Sequence[Requirement]) -> list[str]:
    """Comments of the experiment that keeps `found`."""
    lines = [f"{r.name}: {_distance(found, r)}, negative is beyond it" for r in requirements]
    return [f"Found by twin falsify {experiment}: {found.wrong.kind} violates what is required.", *lines]


def falsify_result(
    experiment: str,
    requirements: Sequence[Requirement],
    found: Sequence[Found],
    holes: Holes,
    space: Space,
    runs: int,
    seconds: float,
    folder: Path,
) -> Result:
    """The verdict, what is required, the kinds that violate it and the nearest that do not, what is not known, then
    where files are.

    Args:
        found: the nearest run of each kind, the worst first.
        holes: what was not tried, and what was not judged.
        seconds: what all runs took together.
    """
    violating = [one for one in found if one.share < 0.0]
    verdict = f"{experiment}  VIOLATED by {len(violating)} of {len(space.kinds)} kinds of fault"
    if not violating:
        count = "any" if len(holes.not_violated) == len(space.kinds) else str(len(holes.not_violated))
        verdict = f"{experiment}  not violated by {count} of {len(space.kinds)} kinds of fault, as far as was searched"
    last = max((one.first or 0 for one in violating), default=0)
    when = f", the last of these kinds was found in run {last}" if violating else ""
    nearest = [*violating, *[one for one in found if one.share >= 0.0][:SHOWN]]
    unknown, files = holes.lines(), [f"  {folder / one.wrong.kind}.toml" for one in violating]
    parts: list[Block] = [
        *(f"  {r.name}  {r.formula}" for r in requirements),
        "",
        Table(COLUMNS, [_row(one, requirements, holes, space) for one in nearest], indent=0),
        *(["", *unknown] if unknown else []),
        *(["", *files] if files else []),
    ]
    facts = {
        "experiment": experiment,
        "requirements": [vars(requirement) for requirement in requirements],
        "runs": runs,
        "seconds": seconds,
        "found": [one.facts(space) for one in found],
        **holes.facts,
    }
    headline = Note(f"{verdict}: {runs} runs, {seconds:.0f} s of processor time{when}.", later=4)
    return Result(headline, parts, facts, exit_code=1 if violating else 0)


def _row(one: Found, requirements: Sequence[Requirement], holes: Holes, space: Space) -> list[Cell]:
    wrong = one.wrong
    return [
        ("! " if one.share < 0.0 else "? " if wrong.kind in holes.ended else "  ") + wrong.kind,
        _distance(one, min(requirements, key=lambda r: one.distances[r.name])),
        magnitude_text(wrong.kind, wrong.magnitude),
        f"{space.onset(wrong):.3f} s",
        wrong.target,
        one.run,
        f"on {wrong.body}" if wrong.body else "",
    ]


def _distance(found: Found, requirement: Requirement) -> str:
    return f"{found.distances[requirement.name]:.4g} {requirement.unit}"
