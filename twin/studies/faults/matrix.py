"""The matrix of faults: one row per fault, with the reactions with the monitor and without, and their judgement."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.robot.experiment.fault import FAULT_KINDS, NO_END_TICK, Fault
from twin.robot.run.runs import Outcome
from twin.studies.faults.cases import Case
from twin.studies.faults.onsets import touching, true_force
from twin.studies.faults.reaction import Reaction, reaction
from twin.studies.faults.stage import Stage

FORCE_ALLOWANCE = 1.2
"""Maximum true peak over the force limit: 20 % for the time that a reaction takes."""
MAX_IDEAL_SHARE = 1.2
"""Maximum peak over the peak with an ideal monitor, where the bound is exceeded."""


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
        ideal: largest force (N) if all drives lost their power as soon as the true force reached the limit, which no
            sensor of the robot could show sooner; None for a row within its bound.
    """

    kind: str
    target: str
    magnitude: float | None
    onset: float
    in_contact: bool
    limit: float
    healthy_peak: float
    watched: Reaction
    unwatched: Reaction
    stays: bool = True
    ideal: float | None = None

    @property
    def force_bound(self) -> float:
        """What the true force is to stay below (N)."""
        return FORCE_ALLOWANCE * self.limit

    @property
    def is_safe(self) -> bool:
        return self.watched.peak <= self.force_bound

    @property
    def is_safe_without_monitor(self) -> bool:
        return self.unwatched.peak <= self.force_bound

    @property
    def is_detected(self) -> bool:
        return bool(self.watched.reason)

    @property
    def is_in_time(self) -> bool:
        """Whether the monitor saw it before the worst was over."""
        seen = self.watched.seen
        return seen is not None and seen <= self.watched.peak_delay

    @property
    def is_largest(self) -> bool:
        """Whether the kind has no larger magnitude in the catalogue."""
        magnitudes = FAULT_KINDS[self.kind].magnitudes
        return magnitudes is None or self.magnitude == magnitudes[-1]

    @property
    def expects_detection(self) -> bool:
        """Whether the catalogue said before the run that the monitor sees it; of a fault that ends it says nothing."""
        return self.stays and FAULT_KINDS[self.kind].expects_detection(self.magnitude, self.in_contact)

    @property
    def expects_excess(self) -> bool:
        """Whether the catalogue said before the run that the force may go beyond the bound."""
        return FAULT_KINDS[self.kind].expects_excess(self.magnitude)

    @property
    def misses_detection(self) -> bool:
        """Whether the monitor did not see what it was said to see."""
        return self.expects_detection and not self.is_detected

    @property
    def is_unavoidable(self) -> bool:
        """Whether the force went beyond the bound, was not said to, and had done so with an ideal monitor, too."""
        ideal = 0.0 if self.ideal is None else self.ideal
        return not self.is_safe and not self.expects_excess and self.watched.peak <= MAX_IDEAL_SHARE * ideal

    @property
    def is_avoidable_excess(self) -> bool:
        """Whether the force went beyond the bound, was not said to, and could have been less."""
        return not self.is_safe and not self.expects_excess and not self.is_unavoidable

    @property
    def fails(self) -> bool:
        """Whether the run did worse than was said before it."""
        return self.misses_detection or self.is_avoidable_excess

    @property
    def matches_statement(self) -> bool:
        """Whether the run did what was said, no worse and no better: what is never seen was not seen in time."""
        return not self.fails and not (FAULT_KINDS[self.kind].detection == "no" and self.is_in_time)

    def to_dict(self) -> dict[str, Any]:
        """For JSON: keys with units, and the judgements."""
        return {
            "kind": self.kind,
            "target": self.target,
            FAULT_KINDS[self.kind].magnitude_key or "magnitude": self.magnitude,
            "onset_s": self.onset,
            "in_contact": self.in_contact,
            "limit_N": self.limit,
            "healthy_peak_N": self.healthy_peak,
            "verdict": "safe" if self.is_safe else "unsafe",
            "detection_stated": FAULT_KINDS[self.kind].detection,
            "as_stated": self.matches_statement,
            "detectable": self.expects_detection,
            "expected_beyond": self.expects_excess,
            "ideal_peak_N": self.ideal,
            # the name of 1.0
            "said_to_go_beyond": self.expects_excess,
            "failed": self.fails,
            "with_monitor": _outcome_to_dict(self.watched),
            "without_monitor": _outcome_to_dict(self.unwatched),
        }


def _outcome_to_dict(one: Reaction) -> dict[str, Any]:
    """Return the reaction for JSON under the names of 1.0."""
    return {
        "peak_N": one.peak,
        "peak_delay_s": one.peak_delay,
        "above_s": one.above,
        "reason": one.reason,
        "delay_s": one.seen,
        "power_off_delay_s": one.power_off,
        "end": one.end,
        "failure": one.failure,
    }


def matrix_rows(stage: Stage, cases: Sequence[Case]) -> Iterator[FaultRow]:
    """Yield one row per case as soon as its runs are done.

    Raises:
        InputRefused: a fault does not fit this robot.
    """
    experiment, force = stage.experiment, true_force(stage.healthy)
    assert experiment.monitor is not None
    tick, limit, touches = experiment.cosim.tick, experiment.monitor.force_limit, touching(stage.healthy)
    with stage:
        for case in cases:
            fault = case.fault
            outcomes = stage.both((fault,))
            watched, unwatched = (reaction(one, experiment, fault.onset, digest=False) for one in outcomes)
            row = FaultRow(
                kind=fault.kind,
                target=fault.target,
                magnitude=case.magnitude,
                onset=fault.onset * tick,
                in_contact=bool(touches[fault.onset]),
                limit=limit,
                healthy_peak=float(force[fault.onset :].max()),
                watched=watched,
                unwatched=unwatched,
                stays=fault.end == NO_END_TICK,
            )
            yield row if row.is_safe else replace(row, ideal=_ideal_peak(stage, fault, outcomes[0], limit))


def _ideal_peak(stage: Stage, fault: Fault, watched: Outcome, limit: float) -> float:
    """Return the largest force (N) if all power is cut when the true force of `watched` reaches `limit` (N)."""
    at = fault.onset + int(np.argmax(true_force(watched)[fault.onset :] >= limit))
    return stage.reaction((fault, Fault("power_off", "power", at))).peak
