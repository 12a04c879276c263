"""Which of two is better, measure by measure, in words."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

SAME = 0.02
"""Share of the larger value within which two count as the same: a fiftieth is what a picture still shows."""
ROUNDING = 1e-9
"""In SI units: values that differ by no more are the same however small they are."""

Values = Mapping[str, float | None]
"""Measures by name, less is better; None: there is none."""


@dataclass(frozen=True)
class Standing:
    """One beside another: names of measures in which it is better, worse, the same; `torn`: now one, now the other."""

    better: tuple[str, ...] = ()
    worse: tuple[str, ...] = ()
    same: tuple[str, ...] = ()
    torn: tuple[str, ...] = ()

    def sentence(self, one: str, other: str) -> str:
        """`B beside A: better in ..., worse in ..., the same in ...`"""
        said = (("better in", self.better), ("worse in", self.worse), ("the same in", self.same))
        parts = [
            f"{how} {', '.join(names)}" for how, names in (*said, ("now better, now worse in", self.torn)) if names
        ]
        return f"{one} beside {other}: {'; '.join(parts) or 'no measure that both have'}"


def standing(one: Values, other: Values) -> Standing:
    """How `one` stands beside `other`, in what both have; infinity is worse than any number."""
    ranks: dict[int, list[str]] = {-1: [], 0: [], 1: []}
    for name, value in one.items():
        beside = other.get(name)
        if value is not None and beside is not None:
            ranks[_rank(value, beside)].append(name)
    return Standing(tuple(ranks[-1]), tuple(ranks[1]), tuple(ranks[0]))


def overall(standings: Sequence[Standing]) -> Standing:
    """Of several: better where it is better in one at least and worse in none, and so on."""
    if len(standings) == 1:
        return standings[0]
    better = [name for one in standings for name in one.better]
    worse = [name for one in standings for name in one.worse]
    same = [name for one in standings for name in one.same]
    return Standing(
        better=_first(name for name in better if name not in worse),
        worse=_first(name for name in worse if name not in better),
        same=_first(name for name in same if name not in better and name not in worse),
        torn=_first(name for name in better if name in worse),
    )


def _first(names: Iterable[str]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(names))


def _rank(value: float, beside: float) -> int:
    # what never happens is at infinity, to which all else is near
    near = math.isfinite(value) and math.isfinite(beside)
    if value == beside or (near and abs(value - beside) <= max(ROUNDING, SAME * max(abs(value), abs(beside)))):
        return 0
    return -1 if value < beside else 1
