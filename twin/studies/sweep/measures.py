"""The measures of a sweep's run: numbers of the true state, with units in their names."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from twin.kernel.errors import InputRefused, nearest
from twin.kernel.serialise import to_dict
from twin.robot.run.measures import HEADLINE_KEYS, MEASURE_ROWS, ROWS_BY_KEY

if TYPE_CHECKING:
    from twin.robot.experiment.measure import Measure
    from twin.robot.run.outcome import RunOutcome

BY_COLUMN = {measure.column: measure for measure in MEASURE_ROWS}
"""Column name in a sweep -> measure of `twin.robot.run.measures`."""
METRICS = tuple(BY_COLUMN)
HOLD_ERROR, HOLD_OVERSHOOT, SETTLING_TIME, CHATTER_AMPLITUDE = (ROWS_BY_KEY[key].column for key in HEADLINE_KEYS)
FELT_STIFFNESS = ROWS_BY_KEY["felt_stiffness"].column
SINCE_TOUCH = ROWS_BY_KEY["force_error"].column
BY_KIND: dict[str, tuple[str, ...]] = {
    "step": (
        "delay_time", "rise_time", "settling_time_2", "settling_time_5", "overshoot", "peak", "steady_state_error",
        "IAE", "ISE", "ITAE",
    ),
    "tracking": ("rms_error", "max_error"),
    "lag": ("lag",),
    "spread": ("mean", "std"),
    "oscillation": ("amplitude", "frequency"),
    "onset": ("time",),
    "path": ("rms_error", "max_error"),
    "effort": ("commanded_travel", "work_delivered", "work_returned"),
    "requirement": ("distance",),
}  # fmt: skip
"""Kind of [[measure]] -> metrics that `twin.studies.check.measurement` computes (SI); needed before any run is made."""


def run_fields(
    status: str, reason: str, metrics: Mapping[str, float | None], seconds: float, stepping: float, **more: Any
) -> dict[str, Any]:
    """Return the fields of a sweep's row that its run determines.

    Args:
        status: "done"; "tripped" if the safety monitor tripped; "failed" if a component failed or the process died;
            "refused" if the values make no valid experiment.
        reason: error message; "" if done.
        metrics: name in `METRICS`, or "measure.metric" for the experiment's measures -> value; empty unless the run
            completed. A value that does not exist is None, or missing for a measure.
        seconds, stepping: wall time in total and of the master alone (s); NaN if the process died.
        more: "no_hold", the reason why the run has no hold error; with `claims` the fields of
            `twin.studies.sweep.claims.findings`.
    """
    fields = {"status": status, "reason": reason, "metrics": metrics}
    return {**fields, "seconds": to_dict(seconds), "stepping_s": to_dict(stepping), **more}


def failure(reason: str) -> dict[str, Any]:
    """Return the row fields of a sweep's run whose process died."""
    return run_fields("failed", reason, {}, math.nan, math.nan)


def metrics_of(outcome: "RunOutcome") -> dict[str, float | None]:
    found = ((measure, outcome.measures[measure.key].value) for measure in MEASURE_ROWS)
    return {measure.column: None if value is None else measure.unit.per_SI * value for measure, value in found}


def metric_names(measures: Sequence["Measure"]) -> tuple[str, ...]:
    """Return the names of all metrics that a sweep's run can have, including the experiment's own measures."""
    return METRICS + tuple(f"{measure.name}.{metric}" for measure in measures for metric in BY_KIND[measure.kind])


def require_metric(place: str, metric: str, known: Sequence[str]) -> str:
    if metric not in known:
        raise InputRefused(f"{place} {metric}: no such metric; {nearest(metric, known)}")
    return metric


def meets_limits(metrics: dict[str, float | None], limits: dict[str, float]) -> bool | None:
    """Return whether a run meets all limits of the sweep; None without limits.

    A missing metric fails its limit, except that a held force without chatter meets the limit of the chatter amplitude.
    """
    if not limits:
        return None
    calm = metrics.get(CHATTER_AMPLITUDE) is None and metrics.get(HOLD_ERROR) is not None
    values = {name: metrics.get(name) for name in limits if not (name == CHATTER_AMPLITUDE and calm)}
    return all(value is not None and value <= limits[name] for name, value in values.items())
