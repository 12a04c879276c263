"""What the search found, as text of at most 80 columns and as facts."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from twin.experiment.fault import CATALOGUE
from twin.studies.falsify.space import Ended, Holes, Space, Wrong
from twin.studies.faults.text import magnitude_text
from twin.studies.lines import wrapped

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

    wrong: Wrong
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
    told = [f"{r.name}: {_distance(found, r)}, negative is beyond it" for r in requirements]
    return [f"Found by twin falsify {experiment}: {found.wrong.kind} violates what is required.", *told]


def falsify_text(
    experiment: str,
    requirements: Sequence[Requirement],
    found: Sequence[Found],
    holes: Holes,
    space: Space,
    runs: int,
    seconds: float,
    folder: Path,
) -> str:
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
        kept = "any" if len(holes.kept) == len(space.kinds) else str(len(holes.kept))
        verdict = f"{experiment}  not violated by {kept} of {len(space.kinds)} kinds of fault, as far as was searched"
    last = max((one.first or 0 for one in violating), default=0)
    when = f", the last of these kinds was found in run {last}" if violating else ""
    lines = wrapped(f"{verdict}: {runs} runs, {seconds:.0f} s of processor time{when}.", later=4)
    lines += [f"  {r.name}  {r.formula}" for r in requirements]
    lines += ["", _line("", "distance", "magnitude", "onset", "target", "run", "")]
    for one in [*violating, *[one for one in found if one.share >= 0.0][:SHOWN]]:
        nearest = min(requirements, key=lambda r: one.distances[r.name])
        wrong, body = one.wrong, f"on {one.wrong.body}" if one.wrong.body else ""
        magnitude, onset = magnitude_text(wrong.kind, wrong.magnitude), f"{space.onset(wrong):.3f} s"
        mark = "! " if one.share < 0.0 else "? " if wrong.kind in holes.ended else "  "
        lines.append(
            _line(mark + wrong.kind, _distance(one, nearest), magnitude, onset, wrong.target, str(one.run), body)
        )
    if unknown := holes.lines():
        lines += ["", *unknown]
    lines += ["", *(f"  {folder / one.wrong.kind}.toml" for one in violating)]
    return "\n".join(line.rstrip() for line in lines).rstrip()


def _distance(found: Found, requirement: Requirement) -> str:
    return f"{found.distances[requirement.name]:.4g} {requirement.unit}"


def _line(kind: str, distance: str, magnitude: str, onset: str, target: str, run: str, body: str) -> str:
    return f"{kind:23} {distance:>10} {magnitude:>11} {onset:>8} {target:15} {run:>4} {body}"
