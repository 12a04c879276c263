"""One row of the matrix: a fault, what it did with the monitor and without, and what that is worth."""

from dataclasses import asdict, dataclass
from typing import Any, Literal

from twin.experiment.fault_catalogue import CATALOGUE

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
        reason: why the monitor tripped, a name of `twin.monitor.reasons.Reason`; FAILURE if the run ended at the fault
            itself; "" if neither.
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
    def said_to_be_seen(self) -> bool:
        """Whether the catalogue said before the run that the monitor sees it; of a fault that ends it says nothing."""
        return self.stays and CATALOGUE[self.kind].is_said_to_be_seen(self.magnitude, self.in_contact)

    @property
    def said_to_go_beyond(self) -> bool:
        """Whether the catalogue said before the run that the force may go beyond the bound."""
        return CATALOGUE[self.kind].is_said_to_go_beyond(self.magnitude)

    @property
    def missed(self) -> bool:
        """Whether the monitor did not see what it was said to see."""
        return self.said_to_be_seen and not self.detected

    @property
    def loose(self) -> bool:
        """Whether the force went beyond the bound and was not said to."""
        return not self.safe and not self.said_to_go_beyond

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
            "detectable": self.said_to_be_seen,
            "said_to_go_beyond": self.said_to_go_beyond,
            "failed": self.fails,
            "with_monitor": _facts(self.watched),
            "without_monitor": _facts(self.unwatched),
        }


def _facts(outcome: FaultOutcome) -> dict[str, Any]:
    units = {"peak": "_N", "peak_delay": "_s", "above": "_s", "delay": "_s", "power_off_delay": "_s"}
    return {key + units.get(key, ""): value for key, value in asdict(outcome).items()}
