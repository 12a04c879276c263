"""Ranking of runs and drives: best, worst, Pareto front, distribution of a metric."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import InputRefused
from twin.studies.metrics.response import Curve
from twin.studies.paper.claim import Claim
from twin.studies.sweep.columns import CategoricalColumn, Columns, Numbers, Positions, Row, cache_per_columns
from twin.studies.sweep.measures import (
    BY_COLUMN,
    CHATTER_AMPLITUDE,
    HOLD_ERROR,
    HOLD_OVERSHOOT,
    METRICS,
    SETTLING_TIME,
    SINCE_TOUCH,
    require_metric,
)
from twin.studies.sweep.rows import ROWS_FILE

USUAL_METRICS = (HOLD_ERROR, SINCE_TOUCH, "lateral_error_mm")
"""Default metrics to rank by; the first that a run of the sweep has is used."""
USUAL_AGAINST = (SETTLING_TIME, HOLD_ERROR, HOLD_OVERSHOOT, "lateral_error_mm")
"""Default second metrics of the Pareto front, likewise."""
UNRANKED_METRICS = ("end_N", "peak_time_s", "hold_mean_error_N", "hold_begin_s", "hold_end_s", "holds_count",
            "felt_stiffness_N_per_m", "chatter_frequency_Hz")  # fmt: skip
UNRANKED_MEASURES = ("mean", "peak", "steady_state_error", "frequency")
"""Metrics without a better direction, whose target is a reference; for every other metric less is better."""

METRIC_DECIMALS = 12
"""Decimals of a metric; differences beyond them are floating-point rounding and do not rank runs."""
QUANTILES = (0.05, 0.25, 0.5, 0.75, 0.95)
HISTOGRAM_BINS = 12
BOOTSTRAP_SAMPLES = 2000
HOLDS_VERDICTS, FAILS_VERDICTS = ("holds", "reproduced after all"), ("fails", "not reproduced")
"""Verdicts counted as success and failure: a sweep asks only whether a claim holds, not whether that was known."""


@cache_per_columns
def value(columns: Columns, metric: str) -> Numbers:
    """Return a metric or claim's quantity per run, (n,); NaN if failed, uncontrolled or without the event."""
    name = f"metrics/{metric}"
    found = columns.numbers(name) if name in columns.by_name else np.full(len(columns), np.nan)
    if f"verdicts/{metric}" in columns.by_name:
        judged = columns.categorical(f"verdicts/{metric}").mask(lambda verdict: verdict is not None)
        found = np.where(judged, columns.numbers(f"values/{metric}"), found)
    return round_metrics(found)


def rank_value(columns: Columns, metric: str) -> Numbers:
    """Return the values that runs are ranked by: the metric, but 0 for a held force without chatter."""
    numbers = value(columns, metric)
    if metric != CHATTER_AMPLITUDE:
        return numbers
    return np.where(np.isnan(numbers) & ~np.isnan(value(columns, HOLD_ERROR)), 0.0, numbers)


def round_metrics(numbers: Numbers) -> Numbers:
    """Round `numbers` to `METRIC_DECIMALS` decimals exactly like Python's `round`, i.e. to the nearest double.

    Scaling by a power of ten and back, as numpy does, is exact except where the product, itself rounded, is close to
    the middle between two decimals. From 2^13 on doubles are further apart than decimals.
    """
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = numbers * 10.0**METRIC_DECIMALS
        whole = np.rint(scaled)
        near_middle = np.abs(np.abs(scaled - whole) - 0.5) <= 2.0**-52 * np.abs(scaled)
    coarse = np.abs(numbers) >= 2.0**13
    found = np.where(coarse, numbers, whole / 10.0**METRIC_DECIMALS)
    doubtful = np.flatnonzero(near_middle & ~coarse)
    found[doubtful] = [round(number, METRIC_DECIMALS) for number in numbers[doubtful].tolist()]
    return found


def usual_metric(columns: Columns) -> str:
    """Return the default metric for ranking: the hold error, the error since the first touch, or the lateral error.

    The second if no run held a force, or the rows are of an older twin; the third if no force was controlled.
    """
    return _first_available(columns, USUAL_METRICS)


def usual_against(columns: Columns, by: str) -> str:
    return _first_available(columns, [metric for metric in USUAL_AGAINST if metric != by])


def _first_available(columns: Columns, metrics: Sequence[str]) -> str:
    return next((metric for metric in metrics if not np.isnan(value(columns, metric)).all()), metrics[0])


@cache_per_columns
def metrics_in(columns: Columns) -> list[str]:
    """Return the names of all metrics that at least one run of a sweep has, built-in metrics first."""
    there = {name: ~np.isnan(columns.numbers(column)) for name, column in columns.names_in_group("metrics").items()}
    found = sorted((name for name, has in there.items() if has.any()), key=lambda name: int(there[name].argmax()))
    return [name for name in METRICS if name in found] + [name for name in found if name not in METRICS]


def claims_in(columns: Columns) -> list[str]:
    return list(columns.names_in_group("verdicts"))


def require_rank(option: str, metric: str, known: Sequence[str], claims: Sequence[str] = ()) -> str:
    """Return a metric if runs can be ranked by it, or by a claim's quantity; `option` begins the message."""
    require_metric(option, metric, [*known, *claims])
    if not claims and _has_no_rank(metric):
        others = ", ".join(name for name in known if not _has_no_rank(name))
        raise InputRefused(f"{option} {metric}: less of it is not better; rank by {others}")
    return metric


def _has_no_rank(metric: str) -> bool:
    return metric in UNRANKED_METRICS or metric.rpartition(".")[2] in UNRANKED_MEASURES


@cache_per_columns
def ranked_rows(columns: Columns, metric: str) -> Positions:
    """Return the rows of completed runs within the sweep's limits, smallest metric first, ties in order."""
    numbers = rank_value(columns, metric)
    fit = columns.categorical("status").mask(lambda status: status == "done")
    fit &= columns.categorical("within_limits").mask(lambda all_curves: all_curves is not False) & ~np.isnan(numbers)
    (rows,) = fit.nonzero()
    return rows[np.argsort(numbers[rows], kind="stable")]


def floor_text(metric: str) -> str:
    """Format the smallest relevant difference of a metric: `0.05 N` or `5 %`; "" if every one is relevant."""
    measure = BY_COLUMN.get(metric)
    if measure is None or not (measure.floor or measure.share):
        return ""
    return f"{measure.unit.per_SI * measure.floor:g} {measure.unit.text}" if measure.floor else f"{measure.share:.0%}"


def floor(metric: str, numbers: Numbers) -> Numbers:
    """Return the largest irrelevant difference from each value; 0 for a metric that is not a measure of twin."""
    measure = BY_COLUMN.get(metric)
    if measure is None:
        return np.zeros_like(numbers)
    return np.maximum(measure.unit.per_SI * measure.floor, measure.share * np.abs(numbers))


@cache_per_columns
def equal_to_best(columns: Columns, metric: str) -> Positions:
    """Return rows not relevantly worse than the best, by settling time (in floors), overshoot, metric."""
    ranked = ranked_rows(columns, metric)
    numbers = rank_value(columns, metric)[ranked]
    if not len(ranked):
        return ranked
    equal = numbers - numbers[0] <= floor(metric, numbers)
    equal[0] = False
    rows = ranked[equal]
    settling = value(columns, SETTLING_TIME)[rows] // BY_COLUMN[SETTLING_TIME].floor
    return rows[np.lexsort((numbers[equal], value(columns, HOLD_OVERSHOOT)[rows], settling))]


def at_edges(columns: Columns, labels: Sequence[str], row: int) -> list[str]:
    """Return the parameters whose value in a run is the smallest or largest of all tried values."""
    found = []
    for label in labels:
        tried = parameter(columns, label)
        low, high = np.nanmin(tried, initial=np.inf), np.nanmax(tried, initial=-np.inf)
        if tried[row] in (low, high) and bool(np.any((tried > low) & (tried < high))):
            found.append(label)
    return found


def parameter(columns: Columns, label: str) -> Numbers:
    """Return the value of a varied parameter in each run, (n,); NaN for booleans and texts."""
    found = columns.by_name.get(f"parameters/{label}")
    if isinstance(found, CategoricalColumn):
        numbers = (
            word if isinstance(word, int | float) and not isinstance(word, bool) else np.nan
            for word in found.categories
        )
        of_words = [float(word) for word in numbers]
        return np.array(of_words)[found.codes]
    return np.full(len(columns), np.nan) if found is None else found


def numeric_labels(labels: Sequence[str], columns: Columns) -> list[str]:
    """Return the varied parameters that are numbers in at least one run, in the given order."""
    return [label for label in labels if not np.isnan(parameter(columns, label)).all()]


def drives_in(columns: Columns) -> list[str | None]:
    """Return the drives of a sweep's runs, in order of first appearance; None is the experiment's own."""
    return list(columns.categorical("drive").counts)


def drive_mask(columns: Columns, drive: str | None) -> NDArray[np.bool_]:
    return columns.categorical("drive").mask(lambda name: name == drive)


@dataclass(frozen=True)
class MetricSpread:
    """Distribution of a metric over the runs of a sweep that have it, with the values at `QUANTILES`.

    Attributes:
        numbers: values in the order of runs.
        counts, edges: counts of `HISTOGRAM_BINS` bins of equal width from the smallest to the largest value, or of a
            single bin if the values differ only by rounding; one edge more than there are bins.
    """

    metric: str
    numbers: Numbers
    missing: int
    quantiles: tuple[float, ...]
    counts: tuple[int, ...]
    edges: Numbers


@cache_per_columns
def metric_spread(columns: Columns, metric: str) -> MetricSpread | None:
    """Return the distribution of a metric over all finished runs; None if no run has it."""
    numbers = value(columns, metric)
    numbers = numbers[~np.isnan(numbers)]
    if len(numbers) == 0:
        return None
    counts, edges = np.histogram(numbers, *_bins(numbers))
    quantiles = tuple(float(number) for number in np.quantile(numbers, QUANTILES))
    return MetricSpread(
        metric, numbers, len(columns) - len(numbers), quantiles, tuple(int(count) for count in counts), edges
    )


def _bins(numbers: Numbers) -> tuple[int, tuple[float, float]]:
    """Return (number of bins, range) of a histogram; one bin if the values hardly differ."""
    scale = max(1.0, float(np.abs(numbers).max()))
    low, high = float(numbers.min()), float(numbers.max())
    if high - low <= 10.0**-METRIC_DECIMALS * scale:
        return 1, (low - 0.5 * scale, high + 0.5 * scale)
    return HISTOGRAM_BINS, (low, high)


@cache_per_columns
def pareto_front(columns: Columns, one: str, other: str) -> Positions:
    """Return the Pareto-optimal rows of two metrics, smallest first metric first.

    Candidates are the rows ranked by `one` that also have `other`. A run dominates another if it has no more of either
    metric and less of one of them.
    """
    rows = ranked_rows(columns, one)
    rows = rows[~np.isnan(rank_value(columns, other)[rows])]
    a, b = rank_value(columns, one)[rows], rank_value(columns, other)[rows]
    # A run with more of `other` than a run with no more of `one` is dominated; few rows are left for sorting by both.
    left = b <= np.minimum.accumulate(b)
    rows, a, b = rows[left], a[left], b[left]
    order = np.lexsort((b, a))
    rows, a, b = rows[order], a[order], b[order]
    before = np.concatenate([[np.inf], np.minimum.accumulate(b)[:-1]])
    first = np.ones(len(rows), bool)
    first[1:] = (a[1:] != a[:-1]) | (b[1:] != b[:-1])
    # Of runs that are equal in both metrics, the first decides for all.
    return rows[(b < before)[first][np.cumsum(first) - 1]] if len(rows) else rows


@dataclass(frozen=True)
class WorstRun:
    """The worst run of a sweep for one choice of the drive and all parameters but one.

    Attributes:
        row: row of the worst run.
        metric: metric of that run; infinity if it failed, tripped, broke a limit or has no number.
        runs, bad: number of runs of this choice; number of these runs without a valid number.
    """

    row: int
    metric: float
    runs: int
    bad: int


def worst_over(columns: Columns, metric: str, label: str, labels: Sequence[str]) -> list[WorstRun]:
    """Find the worst run over one parameter per choice of the others, smallest worst first, ties in order."""
    if not len(columns):
        return []
    others = [
        columns.by_name[name] for one in labels if one != label and (name := f"parameters/{one}") in columns.by_name
    ]
    keys = [
        found.codes if isinstance(found, CategoricalColumn) else np.unique(found, return_inverse=True)[1]
        for found in others
    ]
    keys.append(columns.categorical("drive").codes)
    _, group = np.unique(np.column_stack(keys), axis=0, return_inverse=True)
    group = group.reshape(-1)
    numbers = np.full(len(columns), np.inf)
    counting = ranked_rows(columns, metric)
    numbers[counting] = rank_value(columns, metric)[counting]
    # The largest number of each group; of equal ones the first row.
    order = np.lexsort((-np.arange(len(columns)), numbers, group))
    last: Positions = order[np.flatnonzero(np.diff(group[order], append=-1))]
    runs, bad = np.bincount(group), np.bincount(group, np.isinf(numbers))
    found = [WorstRun(int(row), float(numbers[row]), int(runs[group[row]]), int(bad[group[row]])) for row in last]
    return sorted(found, key=lambda one: (one.metric, one.row))


@dataclass(frozen=True)
class DriveScore:
    """Score of a drive in the ranking of a sweep's drives; its name is "" for the experiment's own.

    Attributes:
        completed: number of runs done with a number.
        median, worst: median and largest metric over the completed runs; NaN without completed runs.
        behind, behind_interval: median over points of the difference to the first drive, and its 95 % interval; NaN for
            the first drive, and where no point was completed by both.
        best: bootstrap probability that the drive ranks first.
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
    def distinguishable(self) -> bool:
        """Whether the runs distinguish the drive from the first: the interval of the difference excludes 0."""
        low, high = self.behind_interval
        return low > 0.0 or high < 0.0


def drive_ranking(columns: Columns, metric: str) -> list[DriveScore]:
    """Rank the drives of a sweep by share of completed runs, then by median of the metric.

    A drive that fails where another is slow must not look better for it, so completed runs count before the median. All
    drives run the same points, so differences are taken point by point, which cancels the common effect of the points
    (common random numbers: Law, Simulation Modeling and Analysis, 11.2). Only points finished by every drive, well or
    badly, are resampled (percentile bootstrap: Efron and Tibshirani 1993, 13.3); equal rows give equal intervals.
    """
    drives = drives_in(columns)
    mine = [drive_mask(columns, drive) for drive in drives]
    # Values of runs that completed without a trip.
    ended = columns.categorical("status").mask(lambda status: status == "done")
    done = np.where(ended, value(columns, metric), np.nan)
    own = [done[is_mine & ~np.isnan(done)] for is_mine in mine]
    runs = [int(is_mine.sum()) for is_mine in mine]
    table = _shared_points(columns, mine, done)
    ranks = [(-len(numbers) / n, _median(numbers)) for n, numbers in zip(runs, own, strict=True)]
    order = sorted(range(len(drives)), key=lambda d: (ranks[d][0], math.isnan(ranks[d][1]), ranks[d][1]))
    chances = _chances(table)
    scores = []
    for d in order:
        behind = (math.nan, (math.nan, math.nan)) if d == order[0] else _median_and_interval(table[d] - table[order[0]])
        worst = float(own[d].max()) if len(own[d]) else math.nan
        name = drives[d] or ""
        scores.append(DriveScore(name, runs[d], len(own[d]), ranks[d][1], worst, *behind, float(chances[d])))
    return scores


def _shared_points(columns: Columns, mine: list[NDArray[np.bool_]], done: Numbers) -> Numbers:
    """Return the metric of each drive, (drives, points), at points finished by every drive; NaN if not completed."""
    point = np.zeros(len(columns), np.intp)
    for name in columns.names_in_group("parameters").values():
        column = columns.by_name[name]
        # Compared bit by bit, so that a missing parameter (NaN) is a value too.
        _, codes = np.unique(
            column.codes if isinstance(column, CategoricalColumn) else column.view(np.int64), return_inverse=True
        )
        _, first, point = np.unique(point * (1 + codes.max()) + codes, return_index=True, return_inverse=True)
        # Number the points in the order of rows.
        point = np.argsort(np.argsort(first))[point]
    table, finished = (np.full((len(mine), 1 + point.max()), nothing) for nothing in (np.nan, False))
    for d, is_mine in enumerate(mine):
        table[d, point[is_mine]], finished[d, point[is_mine]] = done[is_mine], True
    shared: Numbers = table[:, finished.all(axis=0)]
    return shared


def _resample(points: int) -> Iterator[NDArray[np.int64]]:
    """Yield `BOOTSTRAP_SAMPLES` index arrays drawn with replacement from `points` points, one at a time."""
    rng = np.random.default_rng(0)
    return (rng.integers(max(1, points), size=points) for _ in range(BOOTSTRAP_SAMPLES))


def _chances(table: Numbers) -> Numbers:
    """Return each drive's share of the bootstrap samples that it wins, (drives,); a tie is shared."""
    if table.shape[1] == 0:
        return np.full(len(table), np.nan)
    first = np.zeros(len(table))
    for pick in _resample(table.shape[1]):
        drawn = table[:, pick]
        completed = np.isfinite(drawn).sum(axis=1)
        medians = np.array([_median(numbers[np.isfinite(numbers)]) for numbers in drawn])
        medians[completed < completed.max()] = np.inf
        leaders = medians == medians.min() if completed.max() else np.ones(len(table), bool)
        first += leaders / leaders.sum()
    return first / BOOTSTRAP_SAMPLES


def _median_and_interval(differences: Numbers) -> tuple[float, tuple[float, float]]:
    """Return (median, 95 % interval) of a drive's differences to the first drive, point by point."""
    known = differences[np.isfinite(differences)]
    if len(known) == 0:
        return math.nan, (math.nan, math.nan)
    low, high = np.percentile([np.median(known[pick]) for pick in _resample(len(known))], [2.5, 97.5])
    return float(np.median(known)), (float(low), float(high))


def _median(numbers: Numbers) -> float:
    return float(np.median(numbers)) if len(numbers) else math.nan


@dataclass(frozen=True)
class Likelihood:
    """Probability, with its 95 % interval, that a claim of the paper holds in a sweep.

    Attributes:
        trivial: number of runs where the claim is trivial.
        quantiles: measured quantity at `QUANTILES`, in the claim's unit; infinity if the event never happens.
    """

    claim: Claim
    holds: int
    judged: int
    trivial: int
    interval: tuple[float, float]
    quantiles: tuple[float, ...]

    @property
    def share(self) -> float:
        """Share of the judged runs in which the claim holds; NaN without judged runs."""
        return self.holds / self.judged if self.judged else float("nan")


@cache_per_columns
def likelihoods(columns: Columns) -> list[Likelihood]:
    """Return the probability of each claim judged in any run that did not fail, in the paper's order."""
    judged = columns.names_in_group("verdicts")
    if not judged:
        return []
    # Slow to import, and few sweeps judge claims.
    from twin.studies.paper.fig4 import FIG4_CLAIMS, QUALITY_CLAIMS

    found = []
    for claim in (*FIG4_CLAIMS, *QUALITY_CLAIMS):
        if claim.key not in judged:
            continue
        verdicts = columns.categorical(f"verdicts/{claim.key}")
        numbers = columns.numbers(f"values/{claim.key}")[verdicts.mask(lambda verdict: verdict is not None)]
        if not len(numbers):
            continue
        holds, fails = (
            sum(verdicts.counts.get(one, 0) for one in either) for either in (HOLDS_VERDICTS, FAILS_VERDICTS)
        )
        numbers = np.where(np.isnan(numbers), np.inf, numbers)
        # Interpolating between runs could meet infinity, so a quantile is the value of a run.
        quantiles = np.quantile(numbers, QUANTILES, method="inverted_cdf")
        interval = wilson_interval(holds, holds + fails)
        trivial = len(numbers) - holds - fails
        found.append(Likelihood(claim, holds, holds + fails, trivial, interval, tuple(map(float, quantiles))))
    return found


def wilson_interval(successes: int, runs: int) -> tuple[float, float]:
    """Return the 95 % Wilson (1927) interval, (0, 1) for no runs; good for few runs (Brown, Cai, DasGupta 2001)."""
    # Slow to import, and few sweeps judge claims.
    from scipy.stats import binomtest

    if runs == 0:
        return 0.0, 1.0
    interval = binomtest(successes, runs).proportion_ci(0.95, "wilson")
    return float(interval.low), float(interval.high)


@dataclass(frozen=True)
class Bands:
    """Quantiles of curves at each time `t` (s) separately: `bands["position.F_z"]` (quantiles, n), m and N."""

    t: Curve
    quantiles: dict[str, Curve]
    runs: int

    def __getitem__(self, name: str) -> Curve:
        if name not in self.quantiles:
            raise InputRefused(f"{ROWS_FILE}: no run kept its curve {name}; repeat the sweep with another --out")
        return self.quantiles[name]


def bands(rows: Sequence[Row]) -> Bands | None:
    """Compute pointwise quantiles of the runs' curves; None if no run has curves."""
    # Slow to import, and few sweeps judge claims.
    from twin.studies.sweep.claims import unpack_curves

    all_curves = []
    for row in rows:
        if not row.get("curves"):
            continue
        try:
            all_curves.append(unpack_curves(row["curves"]))
            (t, first), (now, curves) = all_curves[0], all_curves[-1]
            if len(now) != len(t) or curves.keys() != first.keys():
                raise ValueError("other curves than the first run")
        except ValueError as problem:
            raise InputRefused(
                f"{ROWS_FILE}: run {row['run']} has damaged curves, or others than the other runs; remove its line, "
                "the run is then done again"
            ) from problem
    if not all_curves:
        return None
    quantiles = {name: np.quantile([values[name] for _, values in all_curves], QUANTILES, axis=0) for name in first}
    return Bands(t, quantiles, len(all_curves))
