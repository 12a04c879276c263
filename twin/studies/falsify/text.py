"""Report of the search for faults, as text of at most 80 columns and for JSON."""

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self

from twin.robot.experiment.together import GROUP_SEPARATOR, PAIR_SEPARATOR, SEQUENCE_SEPARATOR, parse_fault_set
from twin.studies.falsify.space import EarlyEnd, Place, Requirement, Space, TriedFault, offset_text, single_kind
from twin.studies.faults.text import magnitude_text
from twin.studies.result import Block, Cell, Column, Note, Result, Table, count_text, wrap_text

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
"""Maximum number of kinds shown that do not violate, nearest first."""


@dataclass(frozen=True)
class UnviolatedKinds:
    """Fault kinds without a violation and the gaps of the search: untried places and early ends, by kind."""

    untried: Mapping[str, Sequence[Place]]
    places: Mapping[str, int]
    ended: Mapping[str, Sequence[tuple[TriedFault, EarlyEnd]]]
    runs: Mapping[str, int]

    @classmethod
    def from_search(
        cls, space: Space, tried: Sequence[TriedFault], ended: Mapping[TriedFault, EarlyEnd], violating: Collection[str]
    ) -> Self:
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
        """Fault kinds whose runs were all completed without a violation."""
        return [kind for kind in self.places if kind not in self.ended]

    @property
    def json_values(self) -> dict[str, Any]:
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
        """Format the gaps of the search as sentences of at most 80 columns; empty without gaps."""
        lines = []
        for refused, what in ((False, "Ended by a component that failed, judged until then"), (True, "Refused")):
            ends = [(kind, end) for kind, some in self.ended.items() for _, end in some]
            reasons = [(kind, end.reason) for kind, end in ends if end.refused == refused]
            if reasons:
                counts = Counter(kind for kind, _ in reasons)
                cut_short = [f"{kind} ({n} of {count_text(self.runs[kind], 'run')})" for kind, n in counts.items()]
                first = (reasons[0][1].splitlines() or ["no reason was given"])[0]
                lines += wrap_text(f"{what}: {', '.join(cut_short)}. The first: {first}")
        if self.untried:
            left = [f"{kind} {len(some)} of {self.places[kind]}" for kind, some in self.untried.items()]
            places = count_text(sum(map(len, self.untried.values())), "place")
            lines += wrap_text(f"Not tried, {places} (target, sign, body; --runs N tries more): {', '.join(left)}.")
        return lines


@dataclass(frozen=True)
class NearestRun:
    """Run of one fault kind nearest to a violation, with the smallest share of the healthy distance.

    Attributes:
        distances: distance from a violation, by the name of the requirement.
        run: number of the run, from 1.
        first: number of the first violating run of this kind; None without one.
    """

    wrong: TriedFault
    distances: dict[str, float]
    share: float
    run: int
    first: int | None
    ended: EarlyEnd | None = None

    def to_dict(self, space: Space) -> dict[str, Any]:
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
    """Format the comment lines for the experiment file of a found fault."""
    lines = [f"{r.name}: {_distance(found, r)}, negative is beyond it" for r in requirements]
    return [f"Found by twin falsify {experiment}: {found.wrong.kind} violates the requirement.", *lines]


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
    """Create the report of `twin falsify`; `found`: worst first; `seconds`: processor time of all runs (s)."""
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
    """Format the runs nearest to a violation as a table, a row per run; names of sets are long and have the target."""
    rows = [_row(one, requirements, holes, space) for one in found]
    sets = any(
        mark in one.wrong.kind for one in found for mark in (GROUP_SEPARATOR, PAIR_SEPARATOR, SEQUENCE_SEPARATOR)
    )
    if sets:
        name, *others = FOUND_COLUMNS[:4] + FOUND_COLUMNS[5:]
        return Table((replace(name, width=0), *others), [row[:4] + row[5:] for row in rows], indent=0)
    return Table(FOUND_COLUMNS, rows, indent=0)


def _row(one: NearestRun, requirements: Sequence[Requirement], holes: UnviolatedKinds, space: Space) -> list[Cell]:
    wrong = one.wrong
    second = f"2nd {wrong.delay * space.tick:.3g} s later" if SEQUENCE_SEPARATOR in wrong.kind else ""
    where = (second, f"on {wrong.body}" if wrong.body else "", offset_text(wrong.offset))
    return [
        ("! " if one.share < 0.0 else "? " if wrong.kind in holes.ended else "  ") + wrong.kind,
        _distance(one, min(requirements, key=lambda r: one.distances[r.name])),
        size_text(wrong),
        f"{space.onset(wrong):.3f} s",
        wrong.target,
        one.run,
        " ".join(filter(None, where)),
    ]


def _distance(found: NearestRun, requirement: Requirement) -> str:
    return f"{found.distances[requirement.name]:.4g} {requirement.unit}"


def size_text(wrong: TriedFault) -> str:
    """Format the magnitude of a fault, or the share of each fault of a set."""
    parts = parse_fault_set(wrong.kind)
    if len(parts) > 1:
        return " ".join(f"{100 * share:.0f}" for share in wrong.shares) + " %"
    return magnitude_text(parts[0].kind, wrong.magnitude)
