"""Runs by a metric: which is better, and which metrics say that at all."""

import math
from collections.abc import Sequence

from twin.errors import InputRefused
from twin.studies.sweep.measures import METRICS, checked_metric
from twin.studies.sweep.rows import Row
from twin.studies.sweep.vary import Value

USUAL_METRICS = ("force_error_N", "lateral_error_mm")
UNRANKED = ("end_N", "peak_time_s")
UNRANKED_MEASURES = ("mean", "peak", "steady_state_error")
"""Less of these is neither better nor worse: where a force or a signal should end is for its reference to say. Of every
other metric less is better."""

ROUNDING = 12
"""Decimals of a metric: what runs differ by beyond them is the rounding of doubles, and no run is better for it."""


def value(row: Row, metric: str) -> float:
    """The run's number, a metric or what a claim measured; nan if it has none, because it failed or no force was
    controlled, or it never happened."""
    claims = row.get("claims", {})
    found = claims[metric]["value"] if metric in claims else row["metrics"].get(metric)
    return math.nan if found is None else round(float(found), ROUNDING)


def usual_metric(rows: Sequence[Row]) -> str:
    """What runs are ranked by unless somebody says otherwise: the force error, or where no force was controlled, the
    lateral one."""
    force, lateral = USUAL_METRICS
    controlled = any(not math.isnan(value(row, force)) for row in rows)
    return force if controlled or not rows else lateral


def metrics_in(rows: Sequence[Row]) -> list[str]:
    """Names of all metrics that some run has a number for, those of every sweep first."""
    found = dict.fromkeys(name for row in rows for name, number in row["metrics"].items() if number is not None)
    return [name for name in METRICS if name in found] + [name for name in found if name not in METRICS]


def claims_in(rows: Sequence[Row]) -> list[str]:
    """Keys of the paper's claims that some run was judged by; where there are any, no run is better than another."""
    return list(dict.fromkeys(key for row in rows for key in row.get("claims", {})))


def checked_rank(option: str, metric: str, known: Sequence[str], claims: Sequence[str] = ()) -> str:
    """`metric` as it was given with `option`.

    Args:
        known: metrics that a run may have.
        claims: whose numbers may be asked for, too; see `claims_in`.

    Raises:
        InputRefused: there is no such metric, or less of it is not better.
    """
    checked_metric(option, metric, [*known, *claims])
    if not claims and _unranked(metric):
        others = ", ".join(name for name in known if not _unranked(name))
        raise InputRefused(f"{option} {metric}: less of it is neither better nor worse; rank by {others}")
    return metric


def _unranked(metric: str) -> bool:
    return metric in UNRANKED or metric.rpartition(".")[2] in UNRANKED_MEASURES


def best(rows: Sequence[Row], metric: str) -> list[Row]:
    """Runs that did not trip and keep the sweep's limits and have the metric, least first; ties in order of runs."""
    fit = [row for row in rows if row["status"] == "done" and row["within_limits"] is not False]
    found = [(number, row["run"], n) for n, row in enumerate(fit) if not math.isnan(number := value(row, metric))]
    return [fit[n] for _, _, n in sorted(found)]


def is_number(parameter: Value | None) -> bool:
    """Whether a parameter has a rank: truth values and texts have none."""
    return isinstance(parameter, int | float) and not isinstance(parameter, bool)


def numeric_labels(labels: Sequence[str], rows: Sequence[Row]) -> list[str]:
    """Parameters that are numbers in some run, in the order given."""
    return [label for label in labels if any(is_number(row["parameters"].get(label)) for row in rows)]


def drives_in(rows: Sequence[Row]) -> list[str | None]:
    """The drives of `rows`, in the order of runs; None is the experiment's own."""
    return list(dict.fromkeys(row["drive"] for row in rows))
