"""The matrix of faults: cases, one row for each, the healthy run first.

When a fault begins: in free motion and in contact, as a healthy run of the experiment has them.

One row of the matrix: a fault, what it did with the monitor and without, and what that is worth.
"""

from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import ComponentFailed, InputRefused, SafetyTrip
from twin.robot.assembly.roles import refuse_other_parts
from twin.robot.experiment.experiment import Experiment
from twin.robot.experiment.fault import CATALOGUE, GLITCH_SHARE, NEVER, Fault, checked_faults, expected
from twin.robot.monitor.checks import trip_sentence
from twin.studies.faults.together import OF_IDEAL
from twin.studies.faults.trials import FaultTrial, Trials, fault_trial, healthy_run


@dataclass(frozen=True)
class Case:
    """One fault at one time.

    Attributes:
        magnitude: in `unit`, as the catalogue has it; None where the kind has none.
        fault: the same, SI and ticks.
    """

    magnitude: float | None
    fault: Fault


def known_kinds(kinds: Sequence[str]) -> tuple[str, ...]:
    """`kinds`, in the catalogue's order; all of them if none is named.

    Raises:
        InputRefused: one is not in the catalogue.
    """
    for kind in kinds:
        if kind not in CATALOGUE:
            raise InputRefused(f"--kind {kind}: {expected(kind, tuple(CATALOGUE))}")
    return tuple(kind for kind in CATALOGUE if not kinds or kind in kinds)


def cases(
    experiment: Experiment, kinds: Sequence[str], onsets: Sequence[float], duration: float | None
) -> tuple[Case, ...]:
    """kinds x magnitudes x onsets, each on the kind's first target.

    Args:
        onsets: (s).
        duration: of each fault (s); None: to the end.

    Raises:
        InputRefused: an onset or the duration is not one of this experiment.
    """
    end = experiment.duration_ticks * experiment.cosim.tick
    for onset in onsets:
        if not 0.0 <= onset < end:
            raise InputRefused(f"--onset {onset:g}: outside the experiment; expected 0 <= S < {end:g}")
    if duration is not None and not duration > 0.0:
        raise InputRefused(f"--duration {duration:g}: a fault lasts longer than 0 s; without it, to the end")
    return tuple(
        Case(magnitude, _fault(experiment, kind, magnitude, onset, duration))
        for kind in kinds
        for magnitude in CATALOGUE[kind].magnitudes or (None,)
        for onset in onsets
    )


def _fault(experiment: Experiment, kind: str, magnitude: float | None, onset: float, duration: float | None) -> Fault:
    known = CATALOGUE[kind]
    table: dict[str, Any] = {"kind": kind, "onset_s": onset}
    if duration is not None:
        table["duration_s"] = duration
    if known.magnitude_key:
        table[known.magnitude_key] = magnitude
    if known.has_share:
        table["share"] = GLITCH_SHARE
    mistakes: list[str] = []
    faults = checked_faults((table,), experiment.cosim.tick, mistakes)
    if mistakes:
        raise InputRefused("\n".join(mistakes))
    return faults[0]


TOUCH = 0.5
"""True force (N) from which on the robot touches: half the force at which the monitor lets a contact begin."""


def default_onsets(healthy: FaultTrial) -> tuple[int, int]:
    """(a tick in free motion, a tick in contact) of a `healthy` run.

    The first is the middle of the descent to the first contact, the second the middle of the longest contact: the hold
    of a press, the deepest part of a tap, the sweep of Fig. 4.

    Raises:
        InputRefused: it touches nothing.
    """
    contacts = _spans(touching(healthy))
    if len(contacts) == 0:
        raise InputRefused("the healthy run touches nothing, so there is no usual onset; give one with --onset S")
    first = int(contacts[0, 0])
    rests = np.flatnonzero(np.diff(healthy.z[: first + 1]) >= 0.0)
    descent = int(rests[-1]) + 1 if len(rests) else 0
    longest = contacts[np.argmax(contacts[:, 1] - contacts[:, 0])]
    return (descent + first) // 2, int(longest.sum()) // 2


def touching(run: FaultTrial) -> NDArray[np.bool_]:
    """In which ticks the robot touches, (ticks,)."""
    return run.force >= TOUCH


def _spans(true: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Unbroken stretches of True, (n, 2): first tick, and the one after the last."""
    edges = np.diff(np.concatenate([[False], true, [False]]).astype(int))
    return np.flatnonzero(edges).reshape(-1, 2)


ALLOWANCE = 1.2
"""How far above the force limit the true peak may be, as a factor: 20 % for the time that a reaction takes."""

End = Literal["finished", "retracted", "held", "power off", "run ended"]
"""How a run ends: without a trip; clear of the body, or still touching it, after the retraction; with the power taken
because it did not retract; before its time because a component failed."""


@dataclass(frozen=True)
class FaultOutcome:
    """What one run did, from the onset of the fault on.

    Attributes:
        peak: largest true contact force (N).
        peak_delay: from the onset to that (s).
        above: how long the force was above the force limit (s).
        reason: why the monitor tripped, a name of `twin.robot.monitor.checks.Reason`; FAILURE if the run ended at the
            fault itself; "" if neither.
        delay: from the onset to the trip (s).
        power_off_delay: from the onset to the loss of power (s).
        end: see `End`.
        failure: the sentence that ended the run.
    """

    peak: float
    peak_delay: float
    above: float
    reason: str
    delay: float | None
    power_off_delay: float | None
    end: End
    failure: str


@dataclass(frozen=True)
class FaultRow:
    """A fault of the matrix.

    Attributes:
        kind, target: of the fault.
        magnitude: as the catalogue writes it, in its unit; None where there is none.
        onset: (s).
        in_contact: whether the healthy robot touches then.
        limit: the monitor's force limit (N).
        healthy_peak: largest true force of the healthy run from the onset on (N).
        watched, unwatched: with the monitor and without.
        stays: whether the fault lasts to the end of the run.
        ideal: of a row beyond its bound the largest force (N) if all drives lost their power as soon as the true force
            reached the limit, which no sensor of the robot could tell sooner; None: it is not beyond.
    """

    kind: str
    target: str
    magnitude: float | None
    onset: float
    in_contact: bool
    limit: float
    healthy_peak: float
    watched: FaultOutcome
    unwatched: FaultOutcome
    stays: bool = True
    ideal: float | None = None

    @property
    def bound(self) -> float:
        """What the true force is to stay below (N)."""
        return ALLOWANCE * self.limit

    @property
    def safe(self) -> bool:
        return self.watched.peak <= self.bound

    @property
    def safe_unwatched(self) -> bool:
        return self.unwatched.peak <= self.bound

    @property
    def detected(self) -> bool:
        return bool(self.watched.reason)

    @property
    def in_time(self) -> bool:
        """Whether the monitor saw it before the worst was over."""
        delay = self.watched.delay
        return delay is not None and delay <= self.watched.peak_delay

    @property
    def largest(self) -> bool:
        """Whether the kind has no larger magnitude in the catalogue."""
        magnitudes = CATALOGUE[self.kind].magnitudes
        return magnitudes is None or self.magnitude == magnitudes[-1]

    @property
    def detection_expected(self) -> bool:
        """Whether the catalogue said before the run that the monitor sees it; of a fault that ends it says nothing."""
        return self.stays and CATALOGUE[self.kind].expects_detection(self.magnitude, self.in_contact)

    @property
    def expected_beyond(self) -> bool:
        """Whether the catalogue said before the run that the force may go beyond the bound."""
        return CATALOGUE[self.kind].expects_excess(self.magnitude)

    @property
    def missed(self) -> bool:
        """Whether the monitor did not see what it was said to see."""
        return self.detection_expected and not self.detected

    @property
    def unavoidable(self) -> bool:
        """Whether the force went beyond the bound, was not said to, and had done so with an ideal monitor, too."""
        ideal = 0.0 if self.ideal is None else self.ideal
        return not self.safe and not self.expected_beyond and self.watched.peak <= OF_IDEAL * ideal

    @property
    def loose(self) -> bool:
        """Whether the force went beyond the bound, was not said to, and could have been less."""
        return not self.safe and not self.expected_beyond and not self.unavoidable

    @property
    def fails(self) -> bool:
        """Whether the run did worse than was said before it."""
        return self.missed or self.loose

    @property
    def as_stated(self) -> bool:
        """Whether the run did what was said, no worse and no better: what is never seen was not seen in time."""
        return not self.fails and not (CATALOGUE[self.kind].detection == "no" and self.in_time)

    def facts(self) -> dict[str, Any]:
        """For JSON: keys with units, and the judgements."""
        return {
            "kind": self.kind,
            "target": self.target,
            CATALOGUE[self.kind].magnitude_key or "magnitude": self.magnitude,
            "onset_s": self.onset,
            "in_contact": self.in_contact,
            "limit_N": self.limit,
            "healthy_peak_N": self.healthy_peak,
            "verdict": "safe" if self.safe else "unsafe",
            "detection_stated": CATALOGUE[self.kind].detection,
            "as_stated": self.as_stated,
            "detectable": self.detection_expected,
            "expected_beyond": self.expected_beyond,
            "ideal_peak_N": self.ideal,
            # the name of 1.0
            "said_to_go_beyond": self.expected_beyond,
            "failed": self.fails,
            "with_monitor": _facts(self.watched),
            "without_monitor": _facts(self.unwatched),
        }


def _facts(outcome: FaultOutcome) -> dict[str, Any]:
    units = {"peak": "_N", "peak_delay": "_s", "above": "_s", "delay": "_s", "power_off_delay": "_s"}
    return {key + units.get(key, ""): value for key, value in asdict(outcome).items()}


FAILURE = "FAILURE"


def healthy_trial(experiment: Experiment) -> FaultTrial:
    """The run that every row is compared with: no fault, with the monitor.

    Raises:
        InputRefused: `experiment` has no monitor, or it has faults of its own.
        SafetyTrip: the monitor trips although nothing is wrong; nothing can be said of faults then.
        ComponentFailed: a component failed.
    """
    if experiment.monitor is None:
        raise InputRefused(
            f"{experiment.name}: no safety monitor watches this experiment; add a table [monitor] (its limits have "
            "defaults) without enabled = false, or --set monitor.enabled=true"
        )
    refuse_other_parts(experiment, "a matrix of faults", ("monitor",))
    if experiment.faults:
        raise InputRefused(
            f"{experiment.name}: has [[fault]] tables; the matrix inserts one fault at a time, remove them"
        )
    healthy = healthy_run(experiment)
    if healthy.trip is not None:
        raise SafetyTrip(f"{experiment.name}: without any fault: {trip_sentence(healthy.trip)}")
    if healthy.failure:
        raise ComponentFailed(f"{experiment.name}: without any fault: {healthy.failure}")
    return healthy


def onsets_of(experiment: Experiment, healthy: FaultTrial, wanted: Sequence[float]) -> tuple[float, ...]:
    """The onsets `wanted` (s), or if there are none, those that the healthy run suggests.

    Raises:
        InputRefused: see `default_onsets`.
    """
    return tuple(wanted) or tuple(tick * experiment.cosim.tick for tick in default_onsets(healthy))


def matrix_rows(
    experiment: Experiment, healthy: FaultTrial, cases: Sequence[Case], share: bool = True
) -> Iterator[FaultRow]:
    """One row per case, as they come.

    Args:
        share: see `Trials`.

    Raises:
        InputRefused: a fault does not fit this robot.
    """
    assert experiment.monitor is not None
    tick, limit = experiment.cosim.tick, experiment.monitor.force_limit
    with Trials(experiment, share) as trials:
        for case in cases:
            fault = case.fault
            pair = trials.pair(fault)
            watched, unwatched = (outcome(one, fault.onset, tick, limit) for one in pair)
            row = FaultRow(
                kind=fault.kind,
                target=fault.target,
                magnitude=case.magnitude,
                onset=fault.onset * tick,
                in_contact=bool(touching(healthy)[fault.onset]),
                limit=limit,
                healthy_peak=float(healthy.force[fault.onset :].max()),
                watched=watched,
                unwatched=unwatched,
                stays=fault.end == NEVER,
            )
            yield row if row.safe else replace(row, ideal=_ideal_peak(trials, fault, pair[0], limit))


def _ideal_peak(trials: Trials, fault: Fault, watched: FaultTrial, limit: float) -> float:
    """Largest force (N) from the onset on if all power is cut when the true force of `watched` reaches `limit` (N)."""
    at = fault.onset + int(np.argmax(watched.force[fault.onset :] >= limit))
    cut = trials.run((fault, Fault("power_off", "power", at)))
    return float(fault_trial(cut).force[fault.onset :].max())


def outcome(run: FaultTrial, onset: int, tick: float, limit: float) -> FaultOutcome:
    """What `run` did from tick `onset` on.

    Args:
        tick: (s).
        limit: of the force (N).
    """
    # a run that fails in its very first step has no row: it has touched nothing
    force = run.force[onset:] if len(run.force) > onset else np.zeros(1)
    at_fault = run.culprit.startswith("fault_")
    tripped = run.trip.tick if run.trip else max(onset, len(run.force) - 1) if at_fault else None
    return FaultOutcome(
        # the row of the tick in which a step fails is there
        peak=float(force.max()),
        peak_delay=float(tick * force.argmax()),
        above=float(tick * np.count_nonzero(force > limit)),
        reason=run.trip.reason.name if run.trip else FAILURE if at_fault else "",
        delay=None if tripped is None else tick * (tripped - onset),
        power_off_delay=None if run.power_off_tick is None else tick * (run.power_off_tick - onset),
        end=_end(run),
        failure=run.failure,
    )


def _end(run: FaultTrial) -> End:
    if run.failure:
        return "run ended"
    if run.power_off_tick is not None:
        return "power off"
    if run.trip is None:
        return "finished"
    return "held" if touching(run)[-1] else "retracted"
