"""Faults that the search may try, the experiment file of each, and what was not tried.

What the search found, as text of at most 80 columns and as facts.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple, Self

import tomlkit

from twin.robot.experiment.fault import FAULT_KINDS, GLITCH_SHARE, FaultKind
from twin.robot.experiment.source import merge_tables
from twin.robot.experiment.together import (
    GROUP_SEPARATOR,
    PAIR_SEPARATOR,
    RUNAWAY_KIND,
    SEQUENCE_SEPARATOR,
    common_names,
    ordered_names,
    pair_names,
    parse_fault_set,
)
from twin.studies.faults.magnitudes import has_two_ways, magnitude_between, share_of
from twin.studies.faults.offsets import NO_OFFSET, moved_tasks, on_disc
from twin.studies.faults.text import magnitude_text
from twin.studies.faults.together import slowest
from twin.studies.result import Block, Cell, Column, Note, Result, Table, count_text, wrap_text

RANDOM_KINDS = (
    "encoder_dropout_hold", "encoder_dropout_zero", "encoder_dropout_nan", "encoder_glitch", "sample_jitter",
    "sample_loss",
)  # fmt: skip
"""Kinds whose seed matters."""


class Place(NamedTuple):
    """Where a fault can be.

    Attributes:
        target: one of the kind's.
        ways: of each fault of a set 1: as the catalogue has the magnitude; -1: the other sign, or, of a factor, its
            inverse.
        body: what is pressed on; None: the experiment's own.
    """

    target: str
    ways: tuple[int, ...]
    body: str | None


@dataclass(frozen=True)
class TriedFault:
    """One fault in one run.

    Attributes:
        kind: of the catalogue, or the name of a set of faults; "": nothing is wrong.
        target: one of the kind's; of a set that of each, joined by "+".
        magnitude: in the catalogue's unit; None where the kind has none, and of a set of several.
        onset: tick.
        body: what is pressed on; None: the experiment's own.
        seed: of the fault, and added to that of the encoders' noise.
        shares: of a set of several faults that of each, see `Space.magnitude`.
        offset: by which all tasks are moved, x and y (m).
        delay: ticks from the trip that the first fault causes to the second (from its onset if it causes none); of
            faults that begin together 0.
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


@dataclass(frozen=True)
class Space:
    """Where the search looks.

    Attributes:
        base: tables that every run has: settings.
        requirements: (name, formula) of each.
        kinds: of faults.
        ticks: of the experiment; a fault begins before that.
        tick: (s).
        duration: of each fault (s); None: to the end.
        bodies: None among them: the experiment's own.
        seed: of the experiment.
        noisy: whether its encoders have noise.
        tasks: of the experiment.
        reach: how far they may be moved (m).
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
        """Whether another seed makes another run of a fault of `kind`."""
        return self.noisy or any(part.kind in RANDOM_KINDS for part in parse_fault_set(kind))

    def targets(self, kind: str) -> list[str]:
        """Where `kind` may be; of a set every combination."""
        return [PAIR_SEPARATOR.join(targets) for targets in product(*(part.targets for part in parse_fault_set(kind)))]

    def places(self, kind: str) -> list[Place]:
        """Every place of `kind`, that of the catalogue and of the experiment first."""
        return [Place(*place) for place in product(self.targets(kind), product(*ways_of(kind)), self.bodies)]

    def place(self, wrong: TriedFault) -> Place:
        """That of `wrong`."""
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
        """The run of `kind` at a target and on a body.

        Args:
            shares: of each of its faults, see `magnitude`.
            delay: of the second fault after the trip (s).
        """
        target, body = place
        if single_kind(kind) is not None:
            return TriedFault(kind, target, self.magnitude(kind, shares[0]), onset, body, seed, offset=offset)
        # four digits are enough of a search
        rounded = tuple(float(f"{share:.4g}") for share in shares)
        return TriedFault(kind, target, None, onset, body, seed, rounded, offset, round(delay / self.tick))

    def offset(self, outward: float, around: float) -> tuple[float, float]:
        """See `on_disc`."""
        return on_disc(self.reach, outward, around)

    def polar(self, offset: tuple[float, float]) -> tuple[float, float]:
        """What `offset` makes it of."""
        x, y = offset
        return min(1.0, (math.hypot(x, y) / self.reach) ** 2), math.atan2(y, x) / (2.0 * math.pi) % 1.0

    def magnitude(self, kind: str, share: float, number: int = 0) -> float | None:
        """Of fault `number` of a set, see `magnitude_between`; a drive that runs away second may creep."""
        one = parse_fault_set(kind)[number].kind
        return magnitude_between(one, share, self.tick, slowest(one, SEQUENCE_SEPARATOR in kind and number == 1))

    def first_alone(self, wrong: TriedFault) -> TriedFault:
        """The first fault of an ordered pair, without the second."""
        kind, target = wrong.kind.partition(SEQUENCE_SEPARATOR)[0], wrong.target.partition(PAIR_SEPARATOR)[0]
        size = self.magnitude(kind, wrong.shares[0])
        return replace(wrong, kind=kind, target=target, magnitude=size, shares=(), delay=0)

    def shares(self, wrong: TriedFault) -> tuple[float, ...]:
        """Those that `fault` makes `wrong` of; 0 where the kind has no magnitude."""
        return (
            wrong.shares
            if single_kind(wrong.kind) is None
            else (share_of(parse_fault_set(wrong.kind)[0].kind, wrong.magnitude),)
        )

    def file(self, wrong: TriedFault, experiment: Path, comments: Sequence[str] = (), trip: int = 0) -> str:
        """The experiment with what is wrong in it and what is required of it, as TOML that `twin run` takes.

        Args:
            experiment: the file that it extends, as it is found from where it will stand.
            trip: tick from which the second fault of an ordered pair is delayed.
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
        """Of one of its faults."""
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
        """When it begins (s), without the digits that rounding leaves."""
        return float(f"{wrong.onset * self.tick:.12g}")


def may_creep(kind: str) -> bool:
    """Whether the second fault of an ordered pair turns drives, which may be slow."""
    return SEQUENCE_SEPARATOR in kind and parse_fault_set(kind)[1].kind == RUNAWAY_KIND


def single_kind(kind: str) -> FaultKind | None:
    """The kind of the catalogue that a set is of; None: it is of several."""
    parts = parse_fault_set(kind)
    return FAULT_KINDS[parts[0].kind] if len(parts) == 1 else None


def size_text(wrong: TriedFault) -> str:
    """A magnitude, or of a set of several faults the share of each, as people write it."""
    parts = parse_fault_set(wrong.kind)
    if len(parts) > 1:
        return " ".join(f"{100 * share:.0f}" for share in wrong.shares) + " %"
    return magnitude_text(parts[0].kind, wrong.magnitude)


def offset_text(offset: tuple[float, float]) -> str:
    """`at 12.3 -4 mm`; empty where the tasks are where they are."""
    return "" if offset == NO_OFFSET else "at " + " ".join(f"{1e3 * each:.3g}" for each in offset) + " mm"


def known_sets(kinds: Sequence[str], sets: Collection[str]) -> tuple[str, ...]:
    """What is searched: `kinds`, which may be sets; or, where none is named, all of the lists that `sets` names.

    Raises:
        InputRefused: there is no such kind or group.
    """
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
    """Of each fault of a set whether its magnitude may have the other sign, or be the inverse of a factor, too."""
    return [(1, -1) if has_two_ways(part.kind) else (1,) for part in parse_fault_set(kind)]


class EarlyEnd(NamedTuple):
    """Why a run did not come to its end.

    Attributes:
        refused: whether it never began, because its values make no experiment.
        reason: the sentence.
    """

    refused: bool
    reason: str


@dataclass(frozen=True)
class UnviolatedKinds:
    """Of the kinds of which no run violates what is required.

    Attributes:
        untried: places where no run of the kind was made, by kind.
        places: of each kind, how many it has.
        ended: runs that did not come to their end, by kind, each with the reason.
        runs: of each kind, how many were made.
    """

    untried: Mapping[str, Sequence[Place]]
    places: Mapping[str, int]
    ended: Mapping[str, Sequence[tuple[TriedFault, EarlyEnd]]]
    runs: Mapping[str, int]

    @classmethod
    def from_search(
        cls, space: Space, tried: Sequence[TriedFault], ended: Mapping[TriedFault, EarlyEnd], violating: Collection[str]
    ) -> Self:
        """Those of a search.

        Args:
            space: where it looked.
            tried: its runs.
            ended: those that did not come to their end.
            violating: kinds that were found to violate.
        """
        kinds = [kind for kind in space.kinds if kind not in violating]
        places = {kind: space.places(kind) for kind in kinds}
        # a run that was refused tried nothing
        been = {(wrong.kind, space.place(wrong)) for wrong in tried if wrong not in ended or not ended[wrong].refused}
        untried = {kind: [place for place in places[kind] if (kind, place) not in been] for kind in kinds}
        broken = {kind: [(wrong, end) for wrong, end in ended.items() if wrong.kind == kind] for kind in kinds}
        return cls(
            {kind: some for kind, some in untried.items() if some},
            {kind: len(some) for kind, some in places.items()},
            {kind: some for kind, some in broken.items() if some},
            {kind: sum(wrong.kind == kind for wrong in tried) for kind in kinds},
        )

    @property
    def not_violated_kinds(self) -> list[str]:
        """Kinds of which every run came to its end, and none violated what is required."""
        return [kind for kind in self.places if kind not in self.ended]

    @property
    def json_values(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "not_violated": self.not_violated_kinds,
            # the name of 1.0
            "kept": self.not_violated_kinds,
            "not_tried": [
                {
                    "kind": kind,
                    "target": place.target,
                    "way": place.ways[0] if len(place.ways) == 1 else list(place.ways),
                    "body": place.body,
                }
                for kind, some in self.untried.items()
                for place in some
            ],
            "ended_early": [
                {**vars(wrong), "offset_m": list(wrong.offset), "refused": end.refused, "reason": end.reason}
                for some in self.ended.values()
                for wrong, end in some
            ],
        }

    def lines(self) -> list[str]:
        """Sentences of at most 80 columns, if there is anything to say."""
        lines = []
        for refused, what in ((False, "Ended by a component that failed, judged until then"), (True, "Refused")):
            cut_short = []
            reasons = []
            for kind, some in self.ended.items():
                of_these = [end.reason for _, end in some if end.refused == refused]
                if of_these:
                    cut_short.append(f"{kind} ({len(of_these)} of {count_text(self.runs[kind], 'run')})")
                    reasons += of_these
            if cut_short:
                first = (reasons[0].splitlines() or ["no reason was given"])[0]
                lines += wrap_text(f"{what}: {', '.join(cut_short)}. The first: {first}")
        if self.untried:
            left = [f"{kind} {len(some)} of {self.places[kind]}" for kind, some in self.untried.items()]
            number = sum(map(len, self.untried.values()))
            text = f"Not tried, {count_text(number, 'place')} (target, sign, body; --runs N tries more): {', '.join(left)}."
            lines += wrap_text(text)
        return lines


FOUND_COLUMNS = (
    Column("", 23, left=True),
    Column("distance", 10),
    Column("magnitude", 11),
    Column("onset", 8),
    Column("target", 15, left=True),
    Column("run", 4),
    Column(left=True),
)
MAX_SHOWN = 5
"""Kinds that do not violate, the nearest first."""


@dataclass(frozen=True)
class Requirement:
    """What is required: its name, its formula and the unit of its distance."""

    name: str
    formula: str
    unit: str


@dataclass(frozen=True)
class NearestRun:
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
    ended: EarlyEnd | None = None

    def to_dict(self, space: Space) -> dict[str, Any]:
        """For JSON."""
        wrong, known = self.wrong, single_kind(self.wrong.kind)
        return {
            "kind": wrong.kind,
            "target": wrong.target,
            (known and known.magnitude_key) or "magnitude": wrong.magnitude,
            "shares": list(wrong.shares),
            "offset_mm": [1e3 * each for each in wrong.offset],
            "onset_s": space.onset(wrong),
            "after_trip_s": wrong.delay * space.tick if SEQUENCE_SEPARATOR in wrong.kind else None,
            "body": wrong.body,
            "seed": wrong.seed,
            "distances": self.distances,
            "share": self.share,
            "run": self.run,
            "first_violating_run": self.first,
            "ended": self.ended and self.ended.reason,
        }


def header(experiment: str, found: NearestRun, requirements: Sequence[Requirement]) -> list[str]:
    """Comments of the experiment that keeps `found`."""
    lines = [f"{r.name}: {_distance(found, r)}, negative is beyond it" for r in requirements]
    return [f"Found by twin falsify {experiment}: {found.wrong.kind} violates what is required.", *lines]


def falsify_result(
    experiment: str,
    requirements: Sequence[Requirement],
    found: Sequence[NearestRun],
    holes: UnviolatedKinds,
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
        count = "any" if len(holes.not_violated_kinds) == len(space.kinds) else str(len(holes.not_violated_kinds))
        verdict = f"{experiment}  not violated by {count} of {len(space.kinds)} kinds of fault, as far as was searched"
    last = max((one.first or 0 for one in violating), default=0)
    when = f", the last of these kinds was found in run {last}" if violating else ""
    nearest = [*violating, *[one for one in found if one.share >= 0.0][:MAX_SHOWN]]
    unknown, files = holes.lines(), [f"  {folder / one.wrong.kind}.toml" for one in violating]
    parts: list[Block] = [
        *(f"  {r.name}  {r.formula}" for r in requirements),
        "",
        _table(nearest, requirements, holes, space),
        *(["", *unknown] if unknown else []),
        *(["", *files] if files else []),
    ]
    facts = {
        "experiment": experiment,
        "requirements": [vars(requirement) for requirement in requirements],
        "runs": runs,
        "seconds": seconds,
        "found": [one.to_dict(space) for one in found],
        **holes.json_values,
    }
    headline = Note(f"{verdict}: {runs} runs, {seconds:.0f} s of processor time{when}.", later=4)
    return Result(headline, parts, facts, exit_code=1 if violating else 0)


def _table(
    found: Sequence[NearestRun], requirements: Sequence[Requirement], holes: UnviolatedKinds, space: Space
) -> Table:
    """One row each; names of sets are longer than those of kinds, and say where they are."""
    rows = [_row(one, requirements, holes, space) for one in found]
    sets = any(
        mark in one.wrong.kind for one in found for mark in (GROUP_SEPARATOR, PAIR_SEPARATOR, SEQUENCE_SEPARATOR)
    )
    name, distance, magnitude, onset, target, *rest = FOUND_COLUMNS
    if sets:
        return Table(
            (replace(name, width=0), distance, magnitude, onset, *rest), [r[:4] + r[5:] for r in rows], indent=0
        )
    return Table((name, distance, magnitude, onset, target, *rest), rows, indent=0)


def _row(one: NearestRun, requirements: Sequence[Requirement], holes: UnviolatedKinds, space: Space) -> list[Cell]:
    wrong = one.wrong
    return [
        ("! " if one.share < 0.0 else "? " if wrong.kind in holes.ended else "  ") + wrong.kind,
        _distance(one, min(requirements, key=lambda r: one.distances[r.name])),
        size_text(wrong),
        f"{space.onset(wrong):.3f} s",
        wrong.target,
        one.run,
        " ".join(
            filter(
                None,
                (
                    f"2nd {wrong.delay * space.tick:.3g} s later" if SEQUENCE_SEPARATOR in wrong.kind else "",
                    f"on {wrong.body}" if wrong.body else "",
                    offset_text(wrong.offset),
                ),
            )
        ),
    ]


def _distance(found: NearestRun, requirement: Requirement) -> str:
    return f"{found.distances[requirement.name]:.4g} {requirement.unit}"
