"""Runs by a metric: which is better, and which metrics say that at all."""

import math
from collections.abc import Sequence

from twin.errors import InputRefused
from twin.sweep.measures import METRICS
from twin.sweep.rows import Row
from twin.sweep.vary import Value

UNRANKED = ("end_N", "peak_time_s")
"""Less of it is neither better nor worse: what the force should be at the end is the reference's to say. Of every other
metric less is better. Where claims are judged nothing is chosen, so nothing has to be better."""


def value(row: Row, metric: str) -> float:
    """The run's number, a metric or what a claim measured; nan if it has none, because it failed or no force was
    controlled, or it never happened."""
    claims = row.get("claims", {})
    found = claims[metric]["value"] if metric in claims else row["metrics"].get(metric)
    return math.nan if found is None else float(found)


def usual_metric(rows: Sequence[Row]) -> str:
    """What runs are ranked by unless somebody says otherwise: the force error, or where no force was controlled, the
    lateral one."""
    controlled = any(not math.isnan(value(row, "force_error_N")) for row in rows)
    return "force_error_N" if controlled or not rows else "lateral_error_mm"


def metrics_in(rows: Sequence[Row]) -> list[str]:
    """Names of all metrics that some run has a number for, those of every sweep first."""
    found = dict.fromkeys(name for row in rows for name in row["metrics"] if not math.isnan(value(row, name)))
    return [name for name in METRICS if name in found] + [name for name in found if name not in METRICS]


def checked_rank(option: str, metric: str, rows: Sequence[Row]) -> str:
    """`metric` as it was given with `option`; where the paper's claims were judged, a claim's number, too.

    Raises:
        InputRefused: no run has it, or less of it is not better.
    """
    claims = list(dict.fromkeys(key for row in rows for key in row.get("claims", {})))
    if claims and metric in [*metrics_in(rows), *claims]:
        return metric
    known = [name for name in (metrics_in(rows) or METRICS) if name not in UNRANKED] + claims
    if metric in UNRANKED:
        raise InputRefused(f"{option} {metric}: less of it is neither better nor worse; rank by {', '.join(known)}")
    if metric not in known:
        raise InputRefused(f"{option} {metric}: no run has such a metric; known are {', '.join(known)}")
    return metric


def best(rows: Sequence[Row], metric: str) -> list[Row]:
    """Runs that did not trip and keep the sweep's limits and have the metric, least first; ties in order of runs."""
    fit = [row for row in rows if row["status"] == "done" and row["within_limits"] is not False]
    return sorted(
        (row for row in fit if not math.isnan(value(row, metric))), key=lambda row: (value(row, metric), row["run"])
    )


def is_number(parameter: Value | None) -> bool:
    """Whether a parameter has a rank: truth values and texts have none."""
    return isinstance(parameter, int | float) and not isinstance(parameter, bool)


def numeric_labels(labels: Sequence[str], rows: Sequence[Row]) -> list[str]:
    """Parameters that are numbers in some run, in the order given."""
    return [label for label in labels if any(is_number(row["parameters"].get(label)) for row in rows)]


def drives_in(rows: Sequence[Row]) -> list[str | None]:
    """The drives of `rows`, in the order of runs; None is the experiment's own."""
    return list(dict.fromkeys(row["drive"] for row in rows))
