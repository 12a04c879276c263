"""Which drive is best, how sure that is, and which ones the runs cannot tell apart."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.studies.sweep.rows import Row
from twin.studies.sweep.statistics.ranking import drives_in, value

RESAMPLES = 2000
Numbers = NDArray[np.float64]


@dataclass(frozen=True)
class DriveScore:
    """A drive in the sweep.

    Attributes:
        drive: its name; "" for the experiment's own.
        runs: finished.
        completed: of those, done with a number.
        median, worst: of the metric over the completed runs; nan if there is none.
        behind: median over points of how much more it has than the first drive, and its 95 % interval; nan for the
            first, and where no point was completed by both.
        best: chance that it ranks first if the points were drawn anew.
    """

    drive: str
    runs: int
    completed: int
    median: float
    worst: float
    behind: float
    behind_interval: tuple[float, float]
    best: float

    @property
    def told_apart(self) -> bool:
        """Whether its interval leaves out 0: the runs tell it from the first."""
        low, high = self.behind_interval
        return low > 0.0 or high < 0.0


def drive_ranking(rows: Sequence[Row], metric: str) -> list[DriveScore]:
    """Drives: those that completed most first, then by median of the metric.

    A drive that fails where another is slow must not look better for it, so completed runs count before the median.
    All drives run the same points, so differences are taken point by point and what the points do to every drive drops
    out (common random numbers: Law, Simulation Modeling and Analysis, 11.2). Only points that every drive has finished,
    well or badly, are resampled (percentile bootstrap: Efron and Tibshirani 1993, 13.3); the same rows give the same
    intervals.
    """
    drives = drives_in(rows)
    mine = {drive: [row for row in rows if row["drive"] == drive] for drive in drives}
    table = _at_shared_points(rows, drives, metric)
    own = [
        np.array([number for row in mine[drive] if not math.isnan(number := _done(row, metric))]) for drive in drives
    ]
    ranks = [(-len(numbers) / len(mine[drive]), _median(numbers)) for drive, numbers in zip(drives, own, strict=True)]
    order = sorted(range(len(drives)), key=lambda d: (ranks[d][0], math.isnan(ranks[d][1]), ranks[d][1]))
    picks = np.random.default_rng(0).integers(max(1, table.shape[1]), size=(RESAMPLES, table.shape[1]))
    chances = _chances(table, picks)
    scores = []
    for d in order:
        behind = (math.nan, (math.nan, math.nan)) if d == order[0] else _behind(table[d] - table[order[0]])
        worst = float(own[d].max()) if len(own[d]) else math.nan
        name = drives[d] or ""
        scores.append(
            DriveScore(name, len(mine[drives[d]]), len(own[d]), ranks[d][1], worst, *behind, float(chances[d]))
        )
    return scores


def _at_shared_points(rows: Sequence[Row], drives: Sequence[str | None], metric: str) -> Numbers:
    """The metric, (drives, points), at the points that every drive has finished; nan: not completed."""
    at_point: dict[str, dict[str | None, float]] = {}
    for row in rows:
        at_point.setdefault(repr(sorted(row["parameters"].items())), {})[row["drive"]] = _done(row, metric)
    shared = [[found[drive] for drive in drives] for found in at_point.values() if len(found) == len(drives)]
    return np.array(shared).reshape(-1, len(drives)).T


def _chances(table: Numbers, picks: NDArray[np.int64]) -> Numbers:
    """How often each drive ranks first over resampled points, (drives,); a tie is shared."""
    if table.shape[1] == 0:
        return np.full(len(table), np.nan)
    first = np.zeros(len(table))
    for pick in picks:
        drawn = table[:, pick]
        completed = np.isfinite(drawn).sum(axis=1)
        medians = np.array([_median(numbers[np.isfinite(numbers)]) for numbers in drawn])
        medians[completed < completed.max()] = np.inf
        leaders = medians == medians.min() if completed.max() else np.ones(len(table), bool)
        first += leaders / leaders.sum()
    return first / len(picks)


def _behind(differences: Numbers) -> tuple[float, tuple[float, float]]:
    """(median, 95 % interval) of the differences at points that both drives completed."""
    known = differences[np.isfinite(differences)]
    if len(known) == 0:
        return math.nan, (math.nan, math.nan)
    picks = np.random.default_rng(0).integers(len(known), size=(RESAMPLES, len(known)))
    low, high = np.percentile(np.median(known[picks], axis=1), [2.5, 97.5])
    return float(np.median(known)), (float(low), float(high))


def _median(numbers: Numbers) -> float:
    return float(np.median(numbers)) if len(numbers) else math.nan


def _done(row: Row, metric: str) -> float:
    """The number of a run that came to its end without a trip."""
    return value(row, metric) if row["status"] == "done" else math.nan
