"""Which drive is best, how sure that is, and which ones the runs cannot tell apart."""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.studies.sweep.columns import Columns, Numbers, Words
from twin.studies.sweep.statistics.ranking import drives_in, of_drive, value

RESAMPLES = 2000


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


def drive_ranking(columns: Columns, metric: str) -> list[DriveScore]:
    """Drives: those that completed most first, then by median of the metric.

    A drive that fails where another is slow must not look better for it, so completed runs count before the median.
    All drives run the same points, so differences are taken point by point and what the points do to every drive drops
    out (common random numbers: Law, Simulation Modeling and Analysis, 11.2). Only points that every drive has finished,
    well or badly, are resampled (percentile bootstrap: Efron and Tibshirani 1993, 13.3); the same rows give the same
    intervals.
    """
    drives = drives_in(columns)
    mine = [of_drive(columns, drive) for drive in drives]
    done = _done(columns, metric)
    own = [done[is_mine & ~np.isnan(done)] for is_mine in mine]
    runs = [int(is_mine.sum()) for is_mine in mine]
    table = _at_shared_points(columns, mine, done)
    ranks = [(-len(numbers) / n, _median(numbers)) for n, numbers in zip(runs, own, strict=True)]
    order = sorted(range(len(drives)), key=lambda d: (ranks[d][0], math.isnan(ranks[d][1]), ranks[d][1]))
    chances = _chances(table)
    scores = []
    for d in order:
        behind = (math.nan, (math.nan, math.nan)) if d == order[0] else _behind(table[d] - table[order[0]])
        worst = float(own[d].max()) if len(own[d]) else math.nan
        name = drives[d] or ""
        scores.append(DriveScore(name, runs[d], len(own[d]), ranks[d][1], worst, *behind, float(chances[d])))
    return scores


def _at_shared_points(columns: Columns, mine: list[NDArray[np.bool_]], done: Numbers) -> Numbers:
    """The metric, (drives, points), at the points that every drive has finished; nan: not completed."""
    point = np.zeros(len(columns), np.intp)
    for name in columns.under("parameters").values():
        column = columns.of[name]
        # bit by bit: a parameter that is not there is one, too
        _, codes = np.unique(column.codes if isinstance(column, Words) else column.view(np.int64), return_inverse=True)
        _, first, point = np.unique(point * (1 + codes.max()) + codes, return_index=True, return_inverse=True)
        # in the order of rows
        point = np.argsort(np.argsort(first))[point]
    table, finished = (np.full((len(mine), 1 + point.max()), nothing) for nothing in (np.nan, False))
    for d, is_mine in enumerate(mine):
        table[d, point[is_mine]], finished[d, point[is_mine]] = done[is_mine], True
    shared: Numbers = table[:, finished.all(axis=0)]
    return shared


def _resampled(points: int) -> Iterator[NDArray[np.int64]]:
    """So many points drawn from as many, anew each time: one at a time, as all together need not fit in memory."""
    rng = np.random.default_rng(0)
    return (rng.integers(max(1, points), size=points) for _ in range(RESAMPLES))


def _chances(table: Numbers) -> Numbers:
    """How often each drive ranks first over resampled points, (drives,); a tie is shared."""
    if table.shape[1] == 0:
        return np.full(len(table), np.nan)
    first = np.zeros(len(table))
    for pick in _resampled(table.shape[1]):
        drawn = table[:, pick]
        completed = np.isfinite(drawn).sum(axis=1)
        medians = np.array([_median(numbers[np.isfinite(numbers)]) for numbers in drawn])
        medians[completed < completed.max()] = np.inf
        leaders = medians == medians.min() if completed.max() else np.ones(len(table), bool)
        first += leaders / leaders.sum()
    return first / RESAMPLES


def _behind(differences: Numbers) -> tuple[float, tuple[float, float]]:
    """(median, 95 % interval) of the differences at points that both drives completed."""
    known = differences[np.isfinite(differences)]
    if len(known) == 0:
        return math.nan, (math.nan, math.nan)
    low, high = np.percentile([np.median(known[pick]) for pick in _resampled(len(known))], [2.5, 97.5])
    return float(np.median(known)), (float(low), float(high))


def _median(numbers: Numbers) -> float:
    return float(np.median(numbers)) if len(numbers) else math.nan


def _done(columns: Columns, metric: str) -> Numbers:
    """The numbers of runs that came to their end without a trip."""
    return np.where(columns.words("status").are(lambda status: status == "done"), value(columns, metric), np.nan)
