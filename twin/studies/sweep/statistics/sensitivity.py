"""Sensitivity to parameters: rank correlations, and Sobol indices where the design allows them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.studies.sweep.columns import Columns, Numbers, cache_per_columns
from twin.studies.sweep.statistics.ranking import parameter, value

MIN_RUNS = 4
"""Minimum number of runs; with fewer the interval's variance, 1 / (n - 3), is undefined."""
RELIABLE_RUNS = 30
"""Number of runs below which only correlations above 0.36 are significant at 5 %."""
_NORMAL_95 = 1.959963984540054
"""Quantile of the standard normal distribution at 0.975."""
MIN_BLOCKS = 8
MIN_INTERVAL_BLOCKS = 32
"""Minimum number of blocks for an interval; with fewer the coverage is far below 95 %: with 16 an interval may miss an
index four times in five, because A and B are not independent in so short a Sobol' sequence.
"""


@dataclass(frozen=True)
class Correlation:
    """Spearman's rank correlation of a varied parameter with a metric, > 0 if both rise, and its 95 % interval.

    Attributes:
        p: probability of an equally strong correlation if the two were independent.
    """

    rho: float
    low: float
    high: float
    p: float
    runs: int


def rank_correlation(columns: Columns, label: str, metric: str) -> Correlation | None:
    """Compute the rank correlation of a parameter with a metric over the runs of one drive.

    None if too few runs have both, or one is constant. Sources: Spearman (1904), ties share the mean of their ranks.
    Interval: Fisher's z with the variance (1 + rho^2/2) / (n - 3) of Bonett and Wright (2000). p: Student's t with
    n - 2 degrees of freedom (Kendall and Stuart, Advanced Theory of Statistics 2, 31.19). Only monotonic relations are
    detected.
    """
    x, y = parameter(columns, label), value(columns, metric)
    both = ~(np.isnan(x) | np.isnan(y))
    n = int(both.sum())
    if n < MIN_RUNS:
        return None
    x, y = _ranks(x[both]), _ranks_of(columns, metric) if n == np.isfinite(y).sum() else _ranks(y[both])
    if np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return None
    # Slow to import, and most of this package does without scipy.
    from scipy.special import stdtr

    # Centred ranks are multiples of 0.5 with exact sums, so a perfect correlation is exactly 1.
    x, y = x - 0.5 * (n + 1), y - 0.5 * (n + 1)
    rho = max(-1.0, min(1.0, float(x @ y) / math.sqrt(float(x @ x) * float(y @ y))))
    perfect = abs(rho) == 1.0
    # Fisher's z of a perfect correlation is infinite, and so are both ends.
    z = math.copysign(math.inf, rho) if perfect else math.atanh(rho)
    half = _NORMAL_95 * math.sqrt((1.0 + 0.5 * rho * rho) / (n - 3))
    t = math.inf if perfect else abs(rho) * math.sqrt((n - 2) / (1.0 - rho * rho))
    return Correlation(rho, math.tanh(z - half), math.tanh(z + half), float(2.0 * stdtr(n - 2, -t)), n)


@cache_per_columns
def _ranks_of(columns: Columns, metric: str) -> Numbers:
    """Return the ranks of a sweep's runs by a metric, cached since every parameter is correlated with it."""
    numbers = value(columns, metric)
    return _ranks(numbers[~np.isnan(numbers)])


def _ranks(numbers: Numbers) -> Numbers:
    """Return the ranks of `numbers`, from 1; ties share the mean of their ranks."""
    _, which, counts = np.unique(numbers, return_inverse=True, return_counts=True)
    ranks: Numbers = (np.cumsum(counts) - 0.5 * (counts - 1))[which]
    return ranks


Interval = tuple[float, float] | None


@dataclass(frozen=True)
class Index:
    """Sobol' indices of one parameter, each with a nominal 95 % interval (low, high), None with too few blocks.

    The actual coverage was measured on functions with known indices, see docs/sweep.md.

    Attributes:
        first: share of the variance that would vanish if the parameter were known.
        total: share that would remain if everything else were known; exceeds `first` if parameters interact.
    """

    label: str
    first: float
    first_interval: Interval
    total: float
    total_interval: Interval


@dataclass(frozen=True)
class Indices:
    """Sobol' indices of all varied parameters, from the rows of one drive; without entries if they do not exist.

    Attributes:
        remark: reason why they cannot be computed, or a limitation.
        blocks, planned: number of complete blocks of d + 2 runs, and of blocks in the design.
    """

    entries: tuple[Index, ...]
    remark: str
    blocks: int
    planned: int


def sobol_indices(columns: Columns, labels: Sequence[str], runs: int, metric: str) -> Indices:
    """Compute the Sobol' indices of every parameter from the rows of one drive, for design = "saltelli".

    A block with a run that has no number is left out as a whole, since its runs are evaluated relative to each other.

    Args:
        labels: labels of the d parameters, in the order of the design.
        runs: number planned for this drive, in blocks of d + 2 as `saltelli_cube` begins them; run numbers of a drive
            are consecutive.
    """
    width = len(labels) + 2
    planned = runs // width
    if runs % width:
        # Equal runs are planned only once, so the block of a run is then unknown.
        return Indices((), f"{runs} runs are not complete blocks of {width}; draw with another seed", 0, planned)
    run = columns.numbers("run").astype(int)
    first = int(run.min()) if len(run) else 1
    # Rows may be missing, even the drive's first; all drives have equally many blocks.
    start = first - (first - 1) % runs
    block, place = np.divmod(run - start, width)
    # Rows outside the drive's range were edited by hand.
    inside = (block >= 0) & (block < planned)
    blocks = np.full((planned, width), np.nan)
    blocks[block[inside], place[inside]] = value(columns, metric)[inside]
    whole = blocks[np.isfinite(blocks).all(axis=1)]
    if len(whole) < MIN_BLOCKS:
        return Indices((), f"{len(whole)} whole blocks of {width} runs; needs {MIN_BLOCKS}", len(whole), planned)
    if np.ptp(whole) <= 1e-12 * np.abs(whole).max():
        return Indices((), f"{metric} does not vary", len(whole), planned)
    lost = planned - len(whole)
    remark = f"{lost} of {planned} blocks left out: a run in them has no {metric}" if lost else ""
    return Indices(_indices(whole, labels), remark, len(whole), planned)


def estimates(f_A: Numbers, f_B: Numbers, f_AB: Numbers) -> tuple[Numbers, Numbers]:
    """Estimate first-order and total Sobol' indices, (..., d) each, from model outputs.

    Sources: Saltelli et al. (2010), Table 2: (b) for the first order, (f) after Jansen (1999) for the total. Values are
    centred first, which reduces the error and leaves the indices unchanged.

    Args:
        f_A, f_B: model outputs at A and B, (..., n).
        f_AB: model outputs at A with column i taken from B, (..., d, n).
    """
    both = np.concatenate([f_A, f_B], axis=-1)
    variance = both.var(axis=-1)[..., None]
    f_B = f_B - both.mean(axis=-1, keepdims=True)
    change = f_AB - f_A[..., None, :]
    with np.errstate(invalid="ignore", divide="ignore"):
        first = np.mean((f_B[..., None, :]) * change, axis=-1) / variance
        total = 0.5 * np.mean(change**2, axis=-1) / variance
    return first, total


def _indices(blocks: Numbers, labels: Sequence[str]) -> tuple[Index, ...]:
    first, total = estimates(blocks[:, 0], blocks[:, 1], blocks[:, 2:].T)
    halves = half_widths(blocks) if len(blocks) >= MIN_INTERVAL_BLOCKS else np.full((2, len(labels)), np.nan)

    def interval(index: float, half: float) -> Interval:
        return (index - half, index + half) if np.isfinite(half) else None

    return tuple(
        Index(label, F, interval(F, half_F), T, interval(T, half_T))
        for label, F, T, half_F, half_T in zip(
            labels, first.tolist(), total.tolist(), *halves.tolist(), strict=True
        )
    )  # fmt: skip


def half_widths(blocks: Numbers) -> Numbers:
    """Compute half the interval width of each first-order and total index, (2, d), from complete blocks (n, d + 2).

    Student's t at 0.975 with n - 1 degrees of freedom, times the jackknife standard error, i.e. the spread of the
    indices with one block left out at a time (Efron and Tibshirani 1993, Eq. 11.5). NaN where all blocks but one are
    equal.
    """
    # Slow to import, and most of this package does without scipy.
    from scipy.special import stdtrit

    n = len(blocks)
    mean = blocks[:, :2].mean()
    a, b, change = blocks[:, 0, None] - mean, blocks[:, 1, None] - mean, blocks[:, 2:] - blocks[:, :1]

    def without(each: Numbers) -> Numbers:
        """Return the leave-one-out means of a sample, (n, ..)."""
        return (each.sum(axis=0) - each) / (n - 1)

    middle = 0.5 * without(a + b)
    variance = 0.5 * without(a**2 + b**2) - middle**2
    with np.errstate(invalid="ignore", divide="ignore"):
        first = (without(b * change) - middle * without(change)) / variance
        total = 0.5 * without(change**2) / variance
    return np.array([stdtrit(n - 1, 0.975) * np.sqrt((n - 1) * each.var(axis=0)) for each in (first, total)])


def why_no_indices(design: str) -> str:
    """Return the reason why a design allows no Sobol' indices; "" if it allows them."""
    if design == "saltelli":
        return ""
    return f'no Sobol indices: they need design = "saltelli", this is "{design}"; rank correlations need no design'
