"""Faults that act together: common causes, pairs that begin together, and pairs one after the other.

Each row has the peak with an ideal monitor, which cuts the power of all drives at the tick at which the real one trips.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import StrEnum
from itertools import product
from typing import Any, Literal, NamedTuple

from twin.robot.experiment.fault import FAULT_KINDS
from twin.robot.experiment.together import (
    COMMON_CAUSES,
    FAULT_PAIRS,
    ORDERED_PAIRS,
    RUNAWAY_KIND,
    CommonCause,
    PairPart,
    expects_detection,
    fault_values,
)
from twin.studies.faults.cases import faults_of, with_share
from twin.studies.faults.magnitudes import directions
from twin.studies.faults.matrix import MAX_IDEAL_SHARE
from twin.studies.faults.reaction import Reaction
from twin.studies.faults.stage import Stage

MAX_PEAK_SHARE = 1.5
"""Maximum peak over the force limit after faults that act together; or, where that is exceeded, OF_IDEAL."""
SECOND_DELAYS = (0.0, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0)
"""Delays (s) of a second fault after the trip of the first: within the retraction of 0.26 s, and after it."""
MATRIX_DELAYS = (1.0,)
"""Delays (s) that `twin faults` tries."""
SLOW_SPEEDS = (0.05, 0.1, 0.2, 0.4)
"""Speeds (rad/s) of a second drive fault besides the speed of its pair: creeping motors, which no speed limit shows."""
MATRIX_SLOW_SPEEDS = (0.4,)
"""Slow speeds (rad/s) that `twin faults` tries."""


class FaultSet(StrEnum):
    """How many faults at once."""

    SINGLE = "single"
    COMMON = "common"
    PAIRS = "pairs"


class FaultCombination(NamedTuple):
    """Faults that begin together, or one after the other.

    Attributes:
        kind: which of the lists it is from.
        name: for people.
        tables: of the [[fault]]s.
        cause: of a common cause.
        magnitude: of a common cause, as the catalogue has it.
        delay: of the last fault (s), from the trip that the first one causes, or from its onset where it causes none;
            None: all begin together.
    """

    kind: FaultSet
    name: str
    tables: tuple[dict[str, Any], ...]
    cause: CommonCause | None = None
    magnitude: float | None = None
    delay: float | None = None


def common_causes(onset: float, kinds: Sequence[str] = ()) -> Iterator[FaultCombination]:
    """Common causes at `onset` (s): each magnitude and each direction; of `kinds` only, if some are named."""
    for cause in COMMON_CAUSES:
        if kinds and cause.kind not in kinds:
            continue
        for magnitude in FAULT_KINDS[cause.kind].magnitudes or (None,):
            for sign in directions(cause.kind):
                size = None if magnitude is None else sign * magnitude
                tables = (with_share(fault_values(cause.kind, cause.target, size, onset)),)
                yield FaultCombination(FaultSet.COMMON, f"{cause.kind}, {cause.target}", tables, cause, size)


def pairs(onset: float, kinds: Sequence[str] = ()) -> Iterator[FaultCombination]:
    """Pairs at `onset` (s), each fault in each of its directions; of `kinds` only, if some are named."""
    for pair in FAULT_PAIRS:
        if not kinds or {part.kind for part in pair} <= set(kinds):
            for sizes in product(*map(_signed_sizes, pair)):
                tables = tuple(fault_values(p.kind, p.target, size, onset) for p, size in zip(pair, sizes, strict=True))
                yield FaultCombination(FaultSet.PAIRS, " + ".join(part.kind for part in pair), tables)


def slowest(kind: str, later: bool) -> float | None:
    """Smallest magnitude of a search where it is not the catalogue's: drives that run away `later` may creep."""
    return SLOW_SPEEDS[0] if later and kind == RUNAWAY_KIND else None


def _signed_sizes(part: PairPart) -> list[float | None]:
    return [part.magnitude and sign * part.magnitude for sign in directions(part.kind)]


def ordered_pairs(
    onset: float,
    kinds: Sequence[str] = (),
    delays: Sequence[float] = SECOND_DELAYS,
    slow: Sequence[float] = SLOW_SPEEDS,
) -> Iterator[FaultCombination]:
    """Every pair in both orders: one fault at `onset` (s), the other after the trip; of `kinds` only, if any are given.

    Where a drive runs away second, all drives do, too, and each also at the speeds `slow` (rad/s) downwards.
    """
    for first, second in ORDERED_PAIRS:
        if kinds and not {first.kind, second.kind} <= set(kinds):
            continue
        sizes = [*_signed_sizes(second), *(slow if second.kind == RUNAWAY_KIND else ())]
        for size, later, delay in product(_signed_sizes(first), sizes, delays):
            tables = (
                fault_values(first.kind, first.target, size, onset),
                fault_values(second.kind, second.target, later, onset),
            )
            yield FaultCombination(FaultSet.PAIRS, f"{first.kind}, then {second.kind}", tables, delay=delay)


@dataclass(frozen=True)
class CombinationRow:
    """Faults that act together, on one body at one place.

    Attributes:
        faults: what acts.
        stage: where.
        onset: (s).
        in_contact: whether the healthy robot touches then.
        limit: the monitor's force limit (N).
        watched, unwatched: with the monitor and without.
        ideal: largest force (N) with an ideal monitor; None: the real one does not trip.
    """

    faults: FaultCombination
    stage: Stage
    onset: float
    in_contact: bool
    limit: float
    watched: Reaction
    unwatched: Reaction
    ideal: float | None

    @property
    def is_detected(self) -> bool:
        return bool(self.watched.reason)

    @property
    def expects_detection(self) -> bool:
        """Whether it was said before the run that the monitor sees it; of pairs nothing is said."""
        cause = self.faults.cause
        return cause is not None and expects_detection(cause, self.faults.magnitude, self.in_contact)

    @property
    def force_bound(self) -> float:
        """What the force is to stay below (N): of the limit, or of what an ideal monitor reaches."""
        return max(MAX_PEAK_SHARE * self.limit, 0.0 if self.ideal is None else MAX_IDEAL_SHARE * self.ideal)

    @property
    def exceeds_bound(self) -> bool:
        """Whether it does not."""
        return self.watched.peak > self.force_bound

    @property
    def misses_detection(self) -> bool:
        """Whether the monitor did not see what it was said to see."""
        return self.expects_detection and not self.is_detected

    @property
    def verdict(self) -> Literal["kept", "beyond", "missed"]:
        """Whether the force stayed below its bound, and what was said to be seen was seen."""
        return "beyond" if self.exceeds_bound else "missed" if self.misses_detection else "kept"

    @property
    def fails(self) -> bool:
        return self.verdict != "kept"

    def to_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "set": str(self.faults.kind),
            "name": self.faults.name,
            "fault": list(self.faults.tables),
            "body": self.stage.body,
            "offset_m": list(self.stage.offset),
            "onset_s": self.onset,
            "in_contact": self.in_contact,
            "after_trip_s": self.faults.delay,
            "limit_N": self.limit,
            "bound_N": self.force_bound,
            "ideal_peak_N": self.ideal,
            "detectable": self.expects_detection,
            "verdict": self.verdict,
            "failed": self.fails,
            "with_monitor": self.watched.facts(),
            "without_monitor": self.unwatched.facts(),
        }


def combinations_of(kind: FaultSet, onset: float, in_contact: bool, kinds: Sequence[str]) -> list[FaultCombination]:
    """Those of one list; of single faults none. Ordered pairs begin in contact, where they are worse."""
    if kind is FaultSet.PAIRS:
        ordered = ordered_pairs(onset, kinds, MATRIX_DELAYS, MATRIX_SLOW_SPEEDS) if in_contact else ()
        return [*pairs(onset, kinds), *ordered]
    return list(common_causes(onset, kinds)) if kind is FaultSet.COMMON else []


def combination_rows(stage: Stage, wanted: Sequence[FaultSet], kinds: Sequence[str]) -> Iterator[CombinationRow]:
    """Yield one row per case as soon as its runs are done.

    Raises:
        InputRefused: a fault does not fit this robot.
    """
    with stage:
        for kind in (FaultSet.COMMON, FaultSet.PAIRS):
            for onset in stage.onsets:
                for one in combinations_of(kind, onset, stage.touches(onset), kinds) if kind in wanted else ():
                    yield combination_row(stage, one, onset)


def combination_row(stage: Stage, one: FaultCombination, onset: float) -> CombinationRow:
    """Return the row of `one`, whose first fault begins at `onset` (s)."""
    experiment = stage.experiment
    assert experiment.monitor is not None
    if one.delay is not None:
        one = one._replace(tables=stage.delayed(one.tables, one.delay))
    faults, limit = faults_of(experiment, one.tables), experiment.monitor.force_limit
    watched, unwatched = stage.reactions(faults)
    ideal = None if watched.seen is None else stage.ideal(faults, watched.seen).peak
    return CombinationRow(one, stage, onset, stage.touches(onset), limit, watched, unwatched, ideal)
