"""What the rows of a sweep have to say: best runs, what matters, what trades off, which drive is best."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.sweep.rows import Row
from twin.sweep.vary import Value


@dataclass(frozen=True)
class DriveScore:
    """A drive in the sweep.

    Attributes:
        drive: its name; "" for the experiment's own. runs: finished. completed: of those, with metrics.
        median, worst: of the metric over the completed runs; nan if there is none.
        wins: points at which it is the best of all drives.
    """

    drive: str
    runs: int
    completed: int
    median: float
    worst: float
    wins: int


def value(row: Row, metric: str) -> float:
    """The run's number; nan if it has none, because it failed or no force was controlled."""
    found = row["metrics"].get(metric)
    return math.nan if found is None else float(found)


USUAL_METRICS = ("force_error_N", "lateral_error_mm")


def usual_metric(rows: Sequence[Row]) -> str:
    """What runs are ranked by unless somebody says otherwise: the force error, or where no force was controlled, the
    lateral one."""
    force, lateral = USUAL_METRICS
    controlled = any(not math.isnan(value(row, force)) for row in rows)
    return force if controlled or not rows else lateral


def best(rows: Sequence[Row], metric: str) -> list[Row]:
    """Runs that did not trip and keep the sweep's limits and have the metric, least first; ties in order of runs."""
    fit = [row for row in rows if row["status"] == "done" and row["within_limits"] is not False]
    return sorted(
        (row for row in fit if not math.isnan(value(row, metric))), key=lambda row: (value(row, metric), row["run"])
    )


def rank_correlation(rows: Sequence[Row], label: str, metric: str) -> float:
    """Spearman's rank correlation of a parameter with a metric, -1 .. 1, over the runs that have both as numbers.

    nan: fewer than three such runs, or one of the two does not vary.

    Source: Spearman (1904); ties share the mean of their ranks. It sees monotonic relations only.
    """
    pairs = [
        (float(number), value(row, metric))
        for row in rows
        if is_number(number := row["parameters"].get(label)) and not math.isnan(value(row, metric))
    ]
    if len(pairs) < 3:
        return math.nan
    x, y = (_ranks(np.array(column)) for column in zip(*pairs, strict=True))
    if np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return math.nan
    return float(np.corrcoef(x, y)[0, 1])


def pareto_front(rows: Sequence[Row], one: str, other: str) -> list[Row]:
    """Of the runs that `best` would rank, those that no other beats in both metrics; least `one` first.

    A run beats another if it is no worse in either and better in one of them.
    """
    ranked = sorted(best(rows, one), key=lambda row: (value(row, one), value(row, other)))
    front: list[Row] = []
    least = math.inf
    for row in ranked:
        if value(row, other) < least or (front and _same(row, front[-1], one, other)):
            front.append(row)
            least = value(row, other)
    return front


def drive_ranking(rows: Sequence[Row], metric: str) -> list[DriveScore]:
    """Drives: those that completed most first, then by median of the metric.

    A drive that fails where another is slow must not look better for it, so completed runs count before the median.
    """
    drives = list(dict.fromkeys(row["drive"] for row in rows))
    winners = _winners(rows, metric)
    scores = []
    for drive in drives:
        mine = [row for row in rows if row["drive"] == drive]
        values = [value(row, metric) for row in mine]
        values = [number for number in values if not math.isnan(number)]
        middle, worst = (float(np.median(values)), max(values)) if values else (math.nan, math.nan)
        scores.append(DriveScore(drive or "", len(mine), len(values), middle, worst, winners.count(drive)))
    return sorted(scores, key=lambda s: (-s.completed / s.runs, math.isnan(s.median), s.median))


def is_number(parameter: Value | None) -> bool:
    """Whether a parameter has a rank: truth values and texts have none."""
    return isinstance(parameter, int | float) and not isinstance(parameter, bool)


def _winners(rows: Sequence[Row], metric: str) -> list[str | None]:
    """The best drive of each point that all drives have finished."""
    drives = {row["drive"] for row in rows}
    at_point: dict[str, list[Row]] = {}
    for row in rows:
        at_point.setdefault(repr(sorted(row["parameters"].items())), []).append(row)
    complete = [runs for runs in at_point.values() if len(runs) == len(drives)]
    return [ranked[0]["drive"] for runs in complete if (ranked := best(runs, metric))]


def _same(a: Row, b: Row, one: str, other: str) -> bool:
    return all(value(a, metric) == value(b, metric) for metric in (one, other))


def _ranks(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Ranks from 1, ties sharing their mean, (n,)."""
    _, inverse, counts = np.unique(values, return_inverse=True, return_counts=True)
    last = np.cumsum(counts)
    return (last - 0.5 * (counts - 1))[inverse]
