"""Faults that act together, on one body after the other: what a person feels of each, and when it ends.

Beside each run stands that of an ideal monitor, which takes the power of all drives at the tick at which the real one
trips: what no other reaction of the same robot, seeing no more, is asked to better by much.
"""

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from enum import StrEnum
from itertools import product
from typing import Any, Literal, NamedTuple

import numpy as np

from twin.kernel.errors import InputRefused
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import CATALOGUE, GLITCH_SHARE, Fault, checked_faults
from twin.robot.experiment.together import (
    COMMON_CAUSES,
    ORDERED_PAIRS,
    PAIRS,
    RUNAWAY,
    CommonCause,
    PairPart,
    expects,
    table,
)
from twin.robot.run.runs import Outcome
from twin.studies.faults.magnitudes import directions
from twin.studies.faults.trials import Trials

REACHABLE = 1.5
"""Share of the force limit that the peak after a common cause is to stay below."""
OF_IDEAL = 1.2
"""Or, where that is not reached, share of the peak with an ideal monitor."""
LOW = 10.0
"""Force (N) below which the time counts as bearable: that of a firm thumb, and two thirds of the force limit."""
LEFT = 0.1
"""Time (s) at the end of a run over which the force that is left is averaged."""


class FaultSet(StrEnum):
    """How many faults at once."""

    SINGLE = "single"
    COMMON = "common"
    PAIRS = "pairs"


@dataclass(frozen=True)
class Felt:
    """What a person feels of a run, from the onset of the faults on, SI.

    Attributes:
        seen: from the onset to the trip of the monitor; None: no trip.
        acted: to the first command or power at the drives that is the monitor's.
        power_off: to the loss of power, of one drive at least.
        below: to the last time at which the force falls below `LOW`; 0: never above; None: not before the end.
        reason: of the trip; "" if there is none.
        peak: largest true force (N).
        impulse: the true force integrated (N s).
        energy: most that the robot has given to the body (J).
        left: true force at the end (N).
        failure: the sentence that ended the run; "".
        digest: of the true force's bits, by which a run is known again on the same kind of machine.
    """

    seen: float | None
    acted: float | None
    power_off: float | None
    below: float | None
    reason: str
    peak: float
    impulse: float
    energy: float
    left: float
    failure: str
    digest: str

    def facts(self) -> dict[str, Any]:
        """For JSON."""
        units = {"seen": "s", "acted": "s", "power_off": "s", "below": "s", "peak": "N", "impulse": "N_s"}
        units |= {"energy": "J", "left": "N"}
        return {f"{key}_{units[key]}" if key in units else key: value for key, value in asdict(self).items()}


SIGNALS = ("plant.F_ee_B", "plant.v_B")


class FeltRuns(Trials):
    """Runs of one experiment by what a person feels; they share their past. A context manager.

    Args:
        experiment: healthy.
        share: see `Trials`.
    """

    def __init__(self, experiment: Experiment, share: bool = True):
        super().__init__(experiment, share, SIGNALS)
        self._trips: dict[tuple[Fault, ...], float] = {}

    def delayed(self, tables: Sequence[dict[str, Any]], delay: float) -> tuple[dict[str, Any], ...]:
        """`tables` of two [[fault]]s, the second `delay` (s) after the trip that the first one causes; see
        `Together.delay`.

        Raises:
            InputRefused: the first one does not fit.
        """
        first, second = tables
        last = self._experiment.duration_ticks - 1
        later = min(round((first["onset_s"] + self.trip_after(first) + delay) / self._experiment.cosim.tick), last)
        return first, second | {"onset_s": float(f"{later * self._experiment.cosim.tick:.12g}")}

    def trip_after(self, first: dict[str, Any]) -> float:
        """From the onset of a [[fault]] to the trip that it causes alone (s); 0: it causes none."""
        faults = faults_of(self._experiment, [first])
        if faults not in self._trips:
            self._trips[faults] = self.felt(faults).seen or 0.0
        return self._trips[faults]

    def felt(self, faults: Sequence[Fault], watched: bool = True, since: int | None = None) -> Felt:
        """The run with `faults`, with the monitor or without.

        Args:
            since: tick from which on it counts; None: the first onset.

        Raises:
            InputRefused: a drive FMU or a fault does not fit.
        """
        return self._judged(self.run(faults, watched), faults, since)

    def both(self, faults: Sequence[Fault]) -> tuple[Felt, Felt]:
        """The run with the monitor and that without."""
        watched = self.run(faults)
        one = self._judged(watched, faults, None)
        return one, one if self.serves_unwatched(watched) else self.felt(faults, watched=False)

    def ideal(self, faults: Sequence[Fault], seen: float) -> Felt:
        """What a person feels if all drives lose their power `seen` (s) after the onset."""
        onset = min(fault.onset for fault in faults)
        off = Fault("power_off", "power", onset + round(seen / self._experiment.cosim.tick))
        return replace(self.felt((*faults, off), since=onset), power_off=seen)

    def ideal_peak(self, faults: Sequence[Fault], seen: float) -> float:
        """Largest force (N) of that."""
        return self.ideal(faults, seen).peak

    def _judged(self, one: Outcome, faults: Sequence[Fault], since: int | None) -> Felt:
        run, tick = one.trace, self._experiment.cosim.tick
        assert run is not None
        onset = min((fault.onset for fault in faults), default=0) if since is None else since
        # a run that fails in its very first step has no row: it has touched nothing
        F, v = (run[name][onset:] if len(run[name]) > onset else np.zeros((1, 3)) for name in SIGNALS)
        force = np.linalg.norm(F, axis=1)
        high = np.flatnonzero(force >= LOW)
        given = tick * np.cumsum(np.einsum("ij,ij->i", F, v))
        trip, off = one.trip, one.power_off_tick
        seen = None if trip is None else tick * (trip.tick - onset)
        return Felt(
            seen=seen,
            acted=None if seen is None else seen + tick * self._experiment.controller.bus_delay_ticks,
            power_off=None if off is None else tick * (off - onset),
            below=0.0 if not len(high) else None if high[-1] == len(force) - 1 else tick * (int(high[-1]) + 1),
            reason=trip.reason.name if trip else "",
            peak=float(force.max()),
            impulse=float(tick * force.sum()),
            energy=max(0.0, float(given.max())),
            left=float(force[-max(1, round(LEFT / tick)) :].mean()),
            failure=str(one.failure or ""),
            digest=hashlib.sha256(run["plant.F_ee_B"].tobytes()).hexdigest()[:12],
        )


def felt(experiment: Experiment, faults: Sequence[Fault], watched: bool = True) -> Felt:
    """A single run of `experiment`, from the start; see `FeltRuns.felt`."""
    return FeltRuns(experiment, share=False).felt(faults, watched)


class Together(NamedTuple):
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


HERE = (0.0, 0.0)
"""Where the experiment's own tasks are."""


def on_disc(reach: float, outward: float, around: float) -> tuple[float, float]:
    """A place of a disc about the axis, evenly over its area, to a tenth of a millimetre: x, y (m).

    Args:
        reach: radius of the disc (m).
        outward: 0 .. 1, the area within.
        around: 0 .. 1, from x over y.
    """
    radius, angle = reach * math.sqrt(outward), 2.0 * math.pi * around
    return round(radius * math.cos(angle), 4), round(radius * math.sin(angle), 4)


def moved_tasks(tasks: Sequence[Any], offset: tuple[float, float]) -> dict[str, dict[str, list[float]]]:
    """By the number of each [[task]] the keys that move it.

    Args:
        tasks: of an experiment.
        offset: x, y (m).
    """

    def moved(point: Sequence[float]) -> list[float]:
        return [float(f"{1e3 * (a + b):.9g}") for a, b in zip(point, offset, strict=True)]

    return {
        str(number): {f"{key}_mm": moved(getattr(task, key)) for key in ("point", "to") if hasattr(task, key)}
        for number, task in enumerate(tasks, start=1)
    }


def moved_settings(experiment: Experiment, offset: tuple[float, float]) -> tuple[str, ...]:
    """`key=value` of each task that is moved by `offset` (m); none if it is not.

    Raises:
        InputRefused: no task could be moved.
    """
    if offset == HERE:
        return ()
    if not experiment.tasks:
        raise InputRefused(
            f"{experiment.name}: has no [[task]] that could be moved by {1e3 * offset[0]:g}, {1e3 * offset[1]:g} mm"
        )
    moved = moved_tasks(experiment.tasks, offset)
    return tuple(f"task.{n}.{key}=[{x:g},{y:g}]" for n, new in moved.items() for key, (x, y) in new.items())


def places(reach: float) -> tuple[tuple[float, float], ...]:
    """Where the tasks are tried: where they are, and `reach` (m) from there in four directions."""
    return (HERE, (reach, 0.0), (0.0, reach), (-reach, 0.0), (0.0, -reach)) if reach else (HERE,)


def common_causes(onset: float, kinds: Sequence[str] = ()) -> Iterator[Together]:
    """Common causes at `onset` (s): each magnitude and each direction; of `kinds` only, if some are named."""
    for cause in COMMON_CAUSES:
        if kinds and cause.kind not in kinds:
            continue
        for magnitude in CATALOGUE[cause.kind].magnitudes or (None,):
            for sign in directions(cause.kind):
                size = None if magnitude is None else sign * magnitude
                tables = (with_share(table(cause.kind, cause.target, size, onset)),)
                yield Together(FaultSet.COMMON, f"{cause.kind}, {cause.target}", tables, cause, size)


def pairs(onset: float, kinds: Sequence[str] = ()) -> Iterator[Together]:
    """Pairs at `onset` (s), each fault in each of its directions; of `kinds` only, if some are named."""
    for pair in PAIRS:
        if not kinds or {part.kind for part in pair} <= set(kinds):
            for sizes in product(*map(_signed, pair)):
                tables = tuple(table(p.kind, p.target, size, onset) for p, size in zip(pair, sizes, strict=True))
                yield Together(FaultSet.PAIRS, " + ".join(part.kind for part in pair), tables)


DELAYS = (0.0, 0.1, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0)
"""Delays (s) of a second fault after the trip of the first: within the retraction of 0.26 s, and after it."""
ONE_DELAY = (1.0,)
"""The one that `twin faults` tries."""
SLOW, ONE_SLOW = (0.05, 0.1, 0.2, 0.4), (0.4,)
"""Speeds (rad/s) of a second drive fault besides that of its pair: motors that creep, which no limit of speed shows;
and the one that `twin faults` tries."""


def slowest(kind: str, later: bool) -> float | None:
    """Smallest magnitude of a search where it is not the catalogue's: drives that run away `later` may creep."""
    return SLOW[0] if later and kind == RUNAWAY else None


def _signed(part: PairPart) -> list[float | None]:
    return [part.magnitude and sign * part.magnitude for sign in directions(part.kind)]


def ordered_pairs(
    onset: float, kinds: Sequence[str] = (), delays: Sequence[float] = DELAYS, slow: Sequence[float] = SLOW
) -> Iterator[Together]:
    """Every pair in both orders: one fault at `onset` (s), the other after the trip; of `kinds` only, if any are given.

    Where a drive runs away second, all drives do, too, and each also at the speeds `slow` (rad/s) downwards.
    """
    for first, second in ORDERED_PAIRS:
        if kinds and not {first.kind, second.kind} <= set(kinds):
            continue
        sizes = [*_signed(second), *(slow if second.kind == RUNAWAY else ())]
        for size, later, delay in product(_signed(first), sizes, delays):
            tables = (table(first.kind, first.target, size, onset), table(second.kind, second.target, later, onset))
            yield Together(FaultSet.PAIRS, f"{first.kind}, then {second.kind}", tables, delay=delay)


def with_share(one: dict[str, Any]) -> dict[str, Any]:
    """The table of a fault with its second number, where it has one."""
    return one | ({"share": GLITCH_SHARE} if CATALOGUE[one["kind"]].has_share else {})


def faults_of(experiment: Experiment, tables: Sequence[dict[str, Any]]) -> tuple[Fault, ...]:
    """The checked faults of [[fault]] `tables`.

    Raises:
        InputRefused: one is not right.
    """
    mistakes: list[str] = []
    faults = checked_faults(tuple(tables), experiment.cosim.tick, mistakes)
    if mistakes:
        raise InputRefused("\n".join(mistakes))
    return faults


@dataclass(frozen=True)
class TogetherRow:
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

    faults: Together
    stage: "Stage"
    onset: float
    in_contact: bool
    limit: float
    watched: Felt
    unwatched: Felt
    ideal: float | None

    @property
    def detected(self) -> bool:
        return bool(self.watched.reason)

    @property
    def detection_expected(self) -> bool:
        """Whether it was said before the run that the monitor sees it; of pairs nothing is said."""
        cause = self.faults.cause
        return cause is not None and expects(cause, self.faults.magnitude, self.in_contact)

    @property
    def bound(self) -> float:
        """What the force is to stay below (N): of the limit, or of what an ideal monitor reaches."""
        return max(REACHABLE * self.limit, 0.0 if self.ideal is None else OF_IDEAL * self.ideal)

    @property
    def beyond(self) -> bool:
        """Whether it does not."""
        return self.watched.peak > self.bound

    @property
    def missed(self) -> bool:
        """Whether the monitor did not see what it was said to see."""
        return self.detection_expected and not self.detected

    @property
    def verdict(self) -> Literal["kept", "beyond", "missed"]:
        """Whether the force stayed below its bound, and what was said to be seen was seen."""
        return "beyond" if self.beyond else "missed" if self.missed else "kept"

    @property
    def fails(self) -> bool:
        return self.verdict != "kept"

    def facts(self) -> dict[str, Any]:
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
            "bound_N": self.bound,
            "ideal_peak_N": self.ideal,
            "detectable": self.detection_expected,
            "verdict": self.verdict,
            "failed": self.fails,
            "with_monitor": self.watched.facts(),
            "without_monitor": self.unwatched.facts(),
        }


class Stage(NamedTuple):
    """An experiment on one body at one place, and when its faults begin.

    Attributes:
        body: its name; "": the experiment's own.
        experiment: there, healthy.
        onsets: (s), and whether the robot touches then.
        offset: by which all tasks are moved, x and y (m).
    """

    body: str
    experiment: Experiment
    onsets: tuple[tuple[float, bool], ...]
    offset: tuple[float, float] = HERE


def together_of(kind: FaultSet, onset: float, in_contact: bool, kinds: Sequence[str]) -> list[Together]:
    """Those of one list; of single faults none. Ordered pairs begin in contact, where they are worse."""
    if kind is FaultSet.PAIRS:
        ordered = ordered_pairs(onset, kinds, ONE_DELAY, ONE_SLOW) if in_contact else ()
        return [*pairs(onset, kinds), *ordered]
    return list(common_causes(onset, kinds)) if kind is FaultSet.COMMON else []


def together_rows(stage: Stage, wanted: Sequence[FaultSet], kinds: Sequence[str]) -> Iterator[TogetherRow]:
    """One row for each, as they come.

    Raises:
        InputRefused: a fault does not fit this robot.
    """
    with FeltRuns(stage.experiment) as runs:
        for kind in (FaultSet.COMMON, FaultSet.PAIRS):
            for onset, in_contact in stage.onsets:
                for one in together_of(kind, onset, in_contact, kinds) if kind in wanted else ():
                    yield together_row(stage, runs, one, onset, in_contact)


def together_row(stage: Stage, runs: FeltRuns, one: Together, onset: float, in_contact: bool) -> TogetherRow:
    """The row of `one`; `runs` are those of the stage."""
    experiment = stage.experiment
    assert experiment.monitor is not None
    if one.delay is not None:
        one = one._replace(tables=runs.delayed(one.tables, one.delay))
    faults = faults_of(experiment, one.tables)
    watched, unwatched = runs.both(faults)
    ideal = None if watched.seen is None else runs.ideal_peak(faults, watched.seen)
    return TogetherRow(one, stage, onset, in_contact, experiment.monitor.force_limit, watched, unwatched, ideal)
