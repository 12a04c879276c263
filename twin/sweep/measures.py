"""The numbers that a sweep keeps of a run: measures of what is true, with units in their names."""

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from twin.errors import InputRefused

if TYPE_CHECKING:
    from twin.execution.outcome import Outcome

METRICS = ("force_error_N", "peak_N", "peak_time_s", "end_N", "lateral_error_mm", "z_error_mm")
"""Of the plant, see `twin.execution.outcome.Outcome`."""


@dataclass(frozen=True)
class Finding:
    """What became of one run.

    Attributes:
        status: "done"; "tripped": the safety monitor did; "failed": a component did, or the process died;
            "refused": these values make no experiment.
        reason: the sentence; "" if done.
        metrics: by the names of `METRICS`; empty unless the run came to its end. None: there is no such number.
        seconds, stepping: wall time of everything, and of the master alone (s); nan if the process died.
        paper: what a sweep with `claims` keeps besides, see `twin.sweep.fig4.findings`; empty unless the run is done.
    """

    status: str
    reason: str
    metrics: dict[str, float | None]
    seconds: float
    stepping: float
    paper: dict[str, Any] = field(default_factory=dict)

    @property
    def facts(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "status": self.status,
            "reason": self.reason,
            "metrics": self.metrics,
            "seconds": finite(self.seconds),
            "stepping_s": finite(self.stepping),
            **self.paper,
        }


def metrics_of(outcome: "Outcome") -> dict[str, float | None]:
    """`outcome` by the names of `METRICS`."""
    values = (
        outcome.force_error, outcome.peak, outcome.peak_time, outcome.end,
        1e3 * outcome.lateral_error, 1e3 * outcome.z_error,
    )  # fmt: skip
    return {name: finite(value) for name, value in zip(METRICS, values, strict=True)}


def checked_metric(option: str, metric: str) -> str:
    """`metric` as it was given with `option`.

    Raises:
        InputRefused: there is no such metric.
    """
    if metric not in METRICS:
        raise InputRefused(f"{option} {metric}: no such metric; known are {', '.join(METRICS)}")
    return metric


def finite(value: float | None) -> float | None:
    """`value`, or None where JSON has no number for it."""
    return value if value is not None and math.isfinite(value) else None


def within(metrics: dict[str, float | None], limits: dict[str, float]) -> bool | None:
    """Whether a run keeps every limit; a number that is not there keeps none. None: there are no limits."""
    if not limits:
        return None
    values = {name: metrics.get(name) for name in limits}
    return all(value is not None and value <= limits[name] for name, value in values.items())
