"""Rows of the fault matrix: one per fault, with the reactions with the monitor and without, and their judgement."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from twin.robot.experiment.fault import FAULT_KINDS, NO_END_TICK, Fault
from twin.studies.faults.cases import Case
from twin.studies.faults.onsets import true_force
from twin.studies.faults.reaction import Reaction, reaction
from twin.studies.faults.stage import Stage

FORCE_ALLOWANCE = 1.2
"""Maximum true peak over the force limit: 20 % for the time that a reaction takes."""
MAX_IDEAL_SHARE = 1.2
"""Maximum peak over the peak with an ideal monitor, where the bound is exceeded."""


@dataclass(frozen=True)
class FaultRow:
    """Row of the fault matrix: a fault, and the reactions to it.

    Attributes:
        magnitude: magnitude in the catalogue's unit; None for kinds without one.
        onset: onset (s).
        in_contact: whether the healthy robot touches the body at the onset.
        limit: force limit of the monitor (N).
        healthy_peak: largest true force of the healthy run from the onset on (N).
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
        """Maximum true force of a safe row of the fault matrix (N)."""
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
    def is_largest(self) -> bool:
        magnitudes = FAULT_KINDS[self.kind].magnitudes
        return magnitudes is None or self.magnitude == magnitudes[-1]

    @property
    def expects_detection(self) -> bool:
        """Whether the catalogue states that the monitor detects the fault; never of a fault that ends."""
        return self.stays and FAULT_KINDS[self.kind].expects_detection(self.magnitude, self.in_contact)

    @property
    def expects_excess(self) -> bool:
        """Whether the catalogue states that the fault may push the force beyond its bound."""
        return FAULT_KINDS[self.kind].expects_excess(self.magnitude)

    @property
    def misses_detection(self) -> bool:
        return self.expects_detection and not self.is_detected

    @property
    def is_unavoidable(self) -> bool:
        """Whether the fault pushes the force beyond its bound unexpectedly, even with an ideal monitor."""
        ideal = 0.0 if self.ideal is None else self.ideal
        return not self.is_safe and not self.expects_excess and self.watched.peak <= MAX_IDEAL_SHARE * ideal

    @property
    def is_avoidable_excess(self) -> bool:
        """Whether the fault pushes the force beyond its bound unexpectedly, but an ideal monitor would prevent it."""
        return not self.is_safe and not self.expects_excess and not self.is_unavoidable

    @property
    def fails(self) -> bool:
        """Whether the run with the fault is worse than the catalogue states."""
        return self.misses_detection or self.is_avoidable_excess

    @property
    def matches_statement(self) -> bool:
        """Whether the run is as the catalogue states: no failure, and no undetectable fault detected in time."""
        seen = self.watched.seen
        in_time = seen is not None and seen <= self.watched.peak_delay
        return not self.fails and not (FAULT_KINDS[self.kind].detection == "no" and in_time)

    def to_dict(self) -> dict[str, Any]:
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
    """Convert the reaction to a fault to JSON, under the key names of version 1.0."""
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
    """Run every fault of the matrix, and yield its row as soon as its runs are done."""
    experiment, force = stage.experiment, true_force(stage.healthy)
    assert experiment.monitor is not None
    tick, limit = experiment.cosim.tick, experiment.monitor.force_limit
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
                in_contact=stage.touches(fault.onset * tick),
                limit=limit,
                healthy_peak=float(force[fault.onset :].max()),
                watched=watched,
                unwatched=unwatched,
                stays=fault.end == NO_END_TICK,
            )
            if not row.is_safe:
                # the power is cut when the true force reaches the limit
                at = fault.onset + int(np.argmax(true_force(outcomes[0])[fault.onset :] >= limit))
                row = replace(row, ideal=stage.reaction((fault, Fault("power_off", "power", at))).peak)
            yield row
