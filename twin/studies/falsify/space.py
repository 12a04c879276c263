"""Space of faults that the search may try, and the experiment file of each fault."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import tomlkit

from twin.robot.experiment.fault import FAULT_KINDS, GLITCH_SHARE, FaultKind
from twin.robot.experiment.source import merge_tables
from twin.robot.experiment.together import (
    PAIR_SEPARATOR,
    RUNAWAY_KIND,
    SEQUENCE_SEPARATOR,
    common_names,
    ordered_names,
    pair_names,
    parse_fault_set,
)
from twin.studies.faults.magnitudes import has_two_ways, magnitude_between, share_of
from twin.studies.faults.offsets import NO_OFFSET, moved_tasks
from twin.studies.faults.together import slowest

RANDOM_KINDS = (
    "encoder_dropout_hold", "encoder_dropout_zero", "encoder_dropout_nan", "encoder_glitch", "sample_jitter",
    "sample_loss",
)  # fmt: skip
"""Kinds that depend on their seed."""


class Place(NamedTuple):
    """Place of a fault: target, direction and body.

    Attributes:
        ways: direction of each fault of a set: 1 as in the catalogue; -1 the other sign, or the inverse of a factor.
        body: body that is pressed on; None for the experiment's own.
    """

    target: str
    ways: tuple[int, ...]
    body: str | None


@dataclass(frozen=True)
class TriedFault:
    """Fault, or set of faults, of one run of the search.

    Attributes:
        kind: kind of the catalogue, or name of a set; "" for the healthy robot.
        target: target of the kind; targets of a set joined by "+".
        magnitude: magnitude in the catalogue's unit; None for kinds without one, and for sets of several.
        onset: tick.
        seed: seed of the fault, also added to the seed of the encoders' noise.
        shares: share of each fault of a set of several, see `Space.magnitude`.
        offset: offset of all tasks, x and y (m).
        delay: ticks from the trip of the first fault (from its onset without a trip) to the second; 0 for faults that
            begin together.
    """

    kind: str
    target: str = ""
    magnitude: float | None = None
    onset: int = 0
    body: str | None = None
    seed: int = 0
    shares: tuple[float, ...] = ()
    offset: tuple[float, float] = NO_OFFSET
    delay: int = 0


class EarlyEnd(NamedTuple):
    """Early end of a run that failed, or was `refused` because its values are invalid and never began."""

    refused: bool
    reason: str


@dataclass(frozen=True)
class Requirement:
    """Requirement on a run: name, formula, unit of its distance."""

    name: str
    formula: str
    unit: str


@dataclass(frozen=True)
class Space:
    """Search space of faults.

    Attributes:
        requirements: (name, formula) of each.
        ticks: duration of the experiment; faults begin before it.
        tick: duration of a tick (s).
        duration: duration of each fault (s); None for faults that last to the end.
        reach: maximum offset of the tasks (m).
    """

    base: Mapping[str, Any]
    requirements: Sequence[tuple[str, str]]
    kinds: Sequence[str]
    ticks: int
    tick: float
    duration: float | None
    bodies: Sequence[str | None]
    seed: int
    noisy: bool = False
    tasks: Sequence[Any] = ()
    reach: float = 0.0

    def draws(self, kind: str) -> bool:
        """Check whether a run of the fault kind depends on the random seed."""
        return self.noisy or any(part.kind in RANDOM_KINDS for part in parse_fault_set(kind))

    def targets(self, kind: str) -> list[str]:
        """List the targets of a fault kind; every combination of targets for a set."""
        return [PAIR_SEPARATOR.join(targets) for targets in product(*(part.targets for part in parse_fault_set(kind)))]

    def places(self, kind: str) -> list[Place]:
        """List every place of a fault kind, starting with the first target on the experiment's own body."""
        return [Place(*place) for place in product(self.targets(kind), product(*ways_of(kind)), self.bodies)]

    def place(self, wrong: TriedFault) -> Place:
        signs = (-1 if share < 0.0 else 1 for share in self.shares(wrong))
        ways = tuple(sign if sign in ways else 1 for sign, ways in zip(signs, ways_of(wrong.kind), strict=True))
        return Place(wrong.target, ways, wrong.body)

    def fault(
        self,
        kind: str,
        place: tuple[str, str | None],
        shares: Sequence[float],
        onset: int,
        seed: int = 0,
        offset: tuple[float, float] = NO_OFFSET,
        delay: float = 0.0,
    ) -> TriedFault:
        """Create the fault of a kind at a target and on a body, with magnitudes given as shares of their ranges.

        Args:
            shares: share of each fault, see `magnitude`.
            delay: delay of the second fault after the trip (s).
        """
        target, body = place
        if single_kind(kind) is not None:
            return TriedFault(kind, target, self.magnitude(kind, shares[0]), onset, body, seed, offset=offset)
        # four digits are enough of a search
        rounded = tuple(float(f"{share:.4g}") for share in shares)
        return TriedFault(kind, target, None, onset, body, seed, rounded, offset, round(delay / self.tick))

    def polar(self, offset: tuple[float, float]) -> tuple[float, float]:
        """Convert an offset of the tasks to its shares of the area and of a turn, the inverse of `on_disc`."""
        x, y = offset
        return min(1.0, (math.hypot(x, y) / self.reach) ** 2), math.atan2(y, x) / (2.0 * math.pi) % 1.0

    def magnitude(self, kind: str, share: float, number: int = 0) -> float | None:
        """Compute the magnitude of fault `number` of a set, see `magnitude_between`; a second drive fault may creep."""
        one = parse_fault_set(kind)[number].kind
        return magnitude_between(one, share, self.tick, slowest(one, SEQUENCE_SEPARATOR in kind and number == 1))

    def first_alone(self, wrong: TriedFault) -> TriedFault:
        kind, target = wrong.kind.partition(SEQUENCE_SEPARATOR)[0], wrong.target.partition(PAIR_SEPARATOR)[0]
        size = self.magnitude(kind, wrong.shares[0])
        return replace(wrong, kind=kind, target=target, magnitude=size, shares=(), delay=0)

    def shares(self, wrong: TriedFault) -> tuple[float, ...]:
        """Return each fault's magnitude as a share of its range, inverse to `Space.fault`; 0 without a magnitude."""
        if single_kind(wrong.kind) is None:
            return wrong.shares
        return (share_of(parse_fault_set(wrong.kind)[0].kind, wrong.magnitude),)

    def file(self, wrong: TriedFault, experiment: Path, comments: Sequence[str] = (), trip: int = 0) -> str:
        """Create the TOML text of an experiment with the faults of `wrong` and the requirements, for `twin run`.

        Args:
            experiment: file to extend, relative to the folder of the new file.
            trip: start of the delay of an ordered pair's second fault (tick).
        """
        tables = {"extends": str(experiment)} | merge_tables(
            self.base,
            ({"contact": {"body": wrong.body}} if wrong.body is not None else {})
            | ({"seed": self.seed + wrong.seed} if wrong.seed else {})
            | ({"task": moved_tasks(self.tasks, wrong.offset)} if wrong.offset != NO_OFFSET else {})
            | ({"fault": self._tables(wrong, trip)} if wrong.kind else {}),
        )
        tables["measure"] = [
            {"name": name, "kind": "requirement", "formula": formula} for name, formula in self.requirements
        ]
        return "".join(f"# {comment}\n" for comment in comments) + tomlkit.dumps(tables)

    def _tables(self, wrong: TriedFault, trip: int) -> list[dict[str, Any]]:
        parts, targets = parse_fault_set(wrong.kind), wrong.target.split(PAIR_SEPARATOR)
        sizes = [wrong.magnitude]
        if len(parts) > 1:
            sizes = [self.magnitude(wrong.kind, share, number) for number, share in enumerate(wrong.shares)]
        tables = [
            self._table(wrong, part.kind, target, size)
            for part, target, size in zip(parts, targets, sizes, strict=True)
        ]
        if SEQUENCE_SEPARATOR in wrong.kind:
            later = min(trip + wrong.delay, self.ticks - 1)
            tables[1]["onset_s"] = self.onset(replace(wrong, onset=later))
        return tables

    def _table(self, wrong: TriedFault, kind: str, target: str, magnitude: float | None) -> dict[str, Any]:
        known = FAULT_KINDS[kind]
        table: dict[str, Any] = {"kind": kind, "target": target, "onset_s": self.onset(wrong)}
        if self.duration is not None:
            table["duration_s"] = self.duration
        if known.magnitude_key is not None:
            table[known.magnitude_key] = magnitude
        if known.has_share:
            table["share"] = GLITCH_SHARE
        return table | ({"seed": wrong.seed} if wrong.seed else {})

    def onset(self, wrong: TriedFault) -> float:
        """Return the onset of a tried fault (s), rounded to 12 digits."""
        return float(f"{wrong.onset * self.tick:.12g}")


def may_creep(kind: str) -> bool:
    """Check whether the second fault of an ordered pair is a runaway drive, which may be slow."""
    return SEQUENCE_SEPARATOR in kind and parse_fault_set(kind)[1].kind == RUNAWAY_KIND


def single_kind(kind: str) -> FaultKind | None:
    """Return the catalogue's fault kind of a set with one fault; None for several."""
    parts = parse_fault_set(kind)
    return FAULT_KINDS[parts[0].kind] if len(parts) == 1 else None


def known_sets(kinds: Sequence[str], sets: Collection[str]) -> tuple[str, ...]:
    """Select the fault kinds and sets to search: `kinds`, or if empty all kinds of the groups `sets`."""
    for kind in kinds:
        parse_fault_set(kind)
    if kinds:
        return (
            *(kind for kind in FAULT_KINDS if kind in kinds),
            *(k for k in dict.fromkeys(kinds) if k not in FAULT_KINDS),
        )
    lists = {"single": tuple(FAULT_KINDS), "common": common_names(), "pairs": pair_names(), "ordered": ordered_names()}
    return tuple(name for each, names in lists.items() if each in sets for name in names)


def ways_of(kind: str) -> list[tuple[int, ...]]:
    """List the directions to try per fault of a set: (1, -1) if its magnitude may be negated or inverted, else (1,)."""
    return [(1, -1) if has_two_ways(part.kind) else (1,) for part in parse_fault_set(kind)]


def offset_text(offset: tuple[float, float]) -> str:
    """Format the sideways offset of the tasks, `at 12.3 -4 mm`; empty without an offset."""
    return "" if offset == NO_OFFSET else "at " + " ".join(f"{1e3 * each:.3g}" for each in offset) + " mm"
