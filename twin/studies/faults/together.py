"""Faults that act together: common causes, pairs that begin together, and pairs one after the other.

Each row has the peak with an ideal monitor, which cuts the power of all drives at the tick of the real monitor's trip.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
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
from twin.studies.faults import SetOfFaults
from twin.studies.faults.cases import faults_of, with_share
from twin.studies.faults.magnitudes import directions
from twin.studies.faults.matrix import MAX_IDEAL_SHARE
from twin.studies.faults.reaction import Reaction
from twin.studies.faults.stage import Stage

MAX_PEAK_SHARE = 1.5
"""Maximum peak over the force limit after faults that act together; or, where that is exceeded, MAX_IDEAL_SHARE."""
SECOND_DELAYS = (0.0, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0)
"""Delays (s) of a second fault after the trip of the first: within the retraction of 0.26 s, and after it."""
MATRIX_DELAYS = (1.0,)
"""Delays (s) that `twin faults` tries."""
SLOW_SPEEDS = (0.05, 0.1, 0.2, 0.4)
"""Additional speeds (rad/s) of a second drive fault: creeping motors, which no speed limit detects."""
MATRIX_SLOW_SPEEDS = (0.4,)
"""Slow speeds (rad/s) that `twin faults` tries."""


class FaultCombination(NamedTuple):
    """Combination of faults that begin together, or one after the other.

    Attributes:
        cause, magnitude: common cause and its magnitude in the catalogue's unit; None for pairs.
        delay: delay of the second fault (s) after the trip of the first, or after its onset without a trip; None if all
            begin together.
    """

    kind: SetOfFaults
    name: str
    tables: tuple[dict[str, Any], ...]
    cause: CommonCause | None = None
    magnitude: float | None = None
    delay: float | None = None


def common_causes(onset: float, kinds: Sequence[str] = ()) -> Iterator[FaultCombination]:
    """Yield common causes at `onset` (s), with each magnitude and direction; all kinds if `kinds` is empty."""
    for cause in COMMON_CAUSES:
        if kinds and cause.kind not in kinds:
            continue
        for magnitude in FAULT_KINDS[cause.kind].magnitudes or (None,):
            for sign in directions(cause.kind):
                size = None if magnitude is None else sign * magnitude
                tables = (with_share(fault_values(cause.kind, cause.target, size, onset)),)
                yield FaultCombination(SetOfFaults.COMMON, f"{cause.kind}, {cause.target}", tables, cause, size)


def pairs(onset: float, kinds: Sequence[str] = ()) -> Iterator[FaultCombination]:
    """Yield pairs of faults that begin together at `onset` (s), in each direction; all kinds if `kinds` is empty."""
    for pair in FAULT_PAIRS:
        if not kinds or {part.kind for part in pair} <= set(kinds):
            for sizes in product(*map(_signed_sizes, pair)):
                tables = tuple(fault_values(p.kind, p.target, size, onset) for p, size in zip(pair, sizes, strict=True))
                yield FaultCombination(SetOfFaults.PAIRS, " + ".join(part.kind for part in pair), tables)


def slowest(kind: str, later: bool) -> float | None:
    """Return a kind's smallest magnitude to search, None for the catalogue's; a later drive fault may creep."""
    return SLOW_SPEEDS[0] if later and kind == RUNAWAY_KIND else None


def _signed_sizes(part: PairPart) -> list[float | None]:
    return [part.magnitude and sign * part.magnitude for sign in directions(part.kind)]


def ordered_pairs(
    onset: float,
    kinds: Sequence[str] = (),
    delays: Sequence[float] = SECOND_DELAYS,
    slow: Sequence[float] = SLOW_SPEEDS,
) -> Iterator[FaultCombination]:
    """Yield every pair of faults in both orders: one fault at `onset` (s), the other after its trip.

    If the second fault is a runaway drive, a runaway of all drives is also tried, and each at the speeds `slow` (rad/s)
    downwards. An empty `kinds` selects all kinds.
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
            yield FaultCombination(SetOfFaults.PAIRS, f"{first.kind}, then {second.kind}", tables, delay=delay)


@dataclass(frozen=True)
class CombinationRow:
    """Reactions to faults that act together, on one body at one place: a row of the results.

    Attributes:
        onset: onset of the first fault (s).
        in_contact: whether the healthy robot touches the body at the onset.
        limit: force limit of the monitor (N).
        ideal: largest force (N) with an ideal monitor; None without a trip.
    """

    faults: FaultCombination
    stage: Stage
    onset: float
    in_contact: bool
    limit: float
    watched: Reaction
    unwatched: Reaction
    ideal: float | None

    JSON_KEYS = (
        "set=faults.kind name=faults.name fault=faults.tables body=stage.body offset_m=stage.offset onset_s=onset "
        "in_contact after_trip_s=faults.delay limit_N=limit bound_N=force_bound ideal_peak_N=ideal "
        "detectable=expects_detection verdict failed=fails with_monitor=watched without_monitor=unwatched"
    )

    @property
    def is_detected(self) -> bool:
        return bool(self.watched.reason)

    @property
    def expects_detection(self) -> bool:
        """Whether the list of common causes states that the monitor detects the faults; never of pairs."""
        cause = self.faults.cause
        return cause is not None and expects_detection(cause, self.faults.magnitude, self.in_contact)

    @property
    def force_bound(self) -> float:
        """Maximum acceptable force (N) with combined faults: a share of the limit, or of an ideal monitor's peak."""
        return max(MAX_PEAK_SHARE * self.limit, 0.0 if self.ideal is None else MAX_IDEAL_SHARE * self.ideal)

    @property
    def exceeds_bound(self) -> bool:
        return self.watched.peak > self.force_bound

    @property
    def misses_detection(self) -> bool:
        return self.expects_detection and not self.is_detected

    @property
    def verdict(self) -> Literal["kept", "beyond", "missed"]:
        """Return "beyond" if the force exceeds the bound, "missed" if an expected detection is missing, else "kept"."""
        return "beyond" if self.exceeds_bound else "missed" if self.misses_detection else "kept"

    @property
    def fails(self) -> bool:
        return self.verdict != "kept"


def combinations_of(kind: SetOfFaults, onset: float, in_contact: bool, kinds: Sequence[str]) -> list[FaultCombination]:
    """List a kind's combinations, empty for single faults; ordered pairs begin in contact, the worse case."""
    if kind is SetOfFaults.PAIRS:
        ordered = ordered_pairs(onset, kinds, MATRIX_DELAYS, MATRIX_SLOW_SPEEDS) if in_contact else ()
        return [*pairs(onset, kinds), *ordered]
    return list(common_causes(onset, kinds)) if kind is SetOfFaults.COMMON else []


def combination_rows(stage: Stage, wanted: Sequence[SetOfFaults], kinds: Sequence[str]) -> Iterator[CombinationRow]:
    """Run the combinations of faults on a stage, and yield one row per combination as soon as its runs are done."""
    with stage:
        for kind in (SetOfFaults.COMMON, SetOfFaults.PAIRS):
            for onset in stage.onsets:
                for one in combinations_of(kind, onset, stage.touches(onset), kinds) if kind in wanted else ():
                    yield combination_row(stage, one, onset)


def combination_row(stage: Stage, one: FaultCombination, onset: float) -> CombinationRow:
    """Run one combination of faults, the first beginning at `onset` (s), and return its row."""
    experiment = stage.experiment
    assert experiment.monitor is not None
    if one.delay is not None:
        one = one._replace(tables=stage.delay_second(one.tables, one.delay))
    faults, limit = faults_of(experiment, one.tables), experiment.monitor.force_limit
    watched, unwatched = stage.reactions(faults)
    ideal = None if watched.seen is None else stage.ideal_reaction(faults, watched.seen).peak
    return CombinationRow(one, stage, onset, stage.touches(onset), limit, watched, unwatched, ideal)
