"""One row of the matrix: a fault, what it did with the monitor and without, and what that is worth."""

from dataclasses import asdict, dataclass
from typing import Any, Literal, Self

from twin.faults.catalogue import CATALOGUE

ALLOWANCE = 1.2
"""How far above the force limit the true peak may be, as a factor: 20 % for the time that a reaction takes."""

End = Literal["finished", "retracted", "held", "power off", "run ended"]
"""How a run ends: without a trip; clear of the body, or still touching it, after the retraction; with the power taken
because it did not retract; before its time because a component failed."""


@dataclass(frozen=True)
class Outcome:
    """What one run did, from the onset of the fault on.

    Attributes:
        peak: largest true contact force (N). peak_delay: from the onset to that (s).
        above: how long the force was above the force limit (s).
        reason: why the monitor tripped, a name of `twin.monitor.reasons.Reason`; FAILURE if the run ended at the
            fault itself; "" if neither.
        delay: from the onset to the trip (s). power_off_delay: from the onset to the loss of power (s).
        end: see `End`. failure: the sentence that ended the run.
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
class Row:
    """A fault of the matrix.

    Attributes:
        kind, target: of the fault. magnitude: as the catalogue writes it, in its unit; None where there is none.
        onset: (s). in_contact: whether the healthy robot touches then.
        limit: the monitor's force limit (N). healthy_peak: largest true force of the healthy run from the onset on (N).
        watched, unwatched: with the monitor and without.
    """

    kind: str
    target: str
    magnitude: float | None
    onset: float
    in_contact: bool
    limit: float
    healthy_peak: float
    watched: Outcome
    unwatched: Outcome

    @classmethod
    def of(cls, values: dict[str, Any]) -> Self:
        """The row that `dataclasses.asdict` has taken apart."""
        runs = {run: Outcome(**values[run]) for run in ("watched", "unwatched")}
        return cls(**{**values, **runs})

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
    def detectable(self) -> bool:
        """Whether the monitor is answerable for this fault: by the catalogue, or because it saw it."""
        stated = CATALOGUE[self.kind].detection
        if stated == "no":
            return self.in_time
        return stated == "yes" or self.largest or self.detected

    @property
    def fails(self) -> bool:
        """Whether a fault that can be seen went beyond the bound all the same."""
        return self.detectable and not self.safe

    @property
    def as_stated(self) -> bool:
        """Whether the run did what the catalogue says of its detection; "if large" leaves single rows free."""
        stated = CATALOGUE[self.kind].detection
        return self.detected if stated == "yes" else not self.in_time if stated == "no" else True

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
            "detectable": self.detectable,
            "with_monitor": _facts(self.watched),
            "without_monitor": _facts(self.unwatched),
        }


def _facts(outcome: Outcome) -> dict[str, Any]:
    units = {"peak": "_N", "peak_delay": "_s", "above": "_s", "delay": "_s", "power_off_delay": "_s"}
    return {key + units.get(key, ""): value for key, value in asdict(outcome).items()}
