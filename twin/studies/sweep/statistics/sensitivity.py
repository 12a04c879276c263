"""Sensitivity to parameters: rank correlations, and Sobol indices where the design allows them."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.studies.sweep.columns import Columns, Numbers, cache_per_columns
from twin.studies.sweep.statistics.ranking import parameter, value

MIN_RUNS = 4
"""Runs below which the interval has no width to speak of: its variance is 1 / (n - 3)."""
RELIABLE_RUNS = 30
"""Runs below which only a correlation of 0.36 and more differs from none at 5 %."""
_NORMAL_95 = 1.959963984540054
"""Quantile of the standard normal distribution at 0.975."""
MIN_BLOCKS = 8
MIN_INTERVAL_BLOCKS = 32
"""Blocks below which an interval holds far less often than it says: of 16 it may miss an index four times in five, for
in so short a Sobol' sequence A and B are not independent."""


@dataclass(frozen=True)
class Correlation:
    """Spearman's rank correlation of a parameter with a metric.

    Attributes:
        rho: -1 .. 1, positive if the metric rises with the parameter.
        low, high: 95 % interval.
        p: chance of as strong a one if the two had nothing to do with each other.
        runs: that it is of.
    """

    rho: float
    low: float
    high: float
    p: float
    runs: int


def rank_correlation(columns: Columns, label: str, metric: str) -> Correlation | None:
    """Over the runs of one drive that have both as numbers; None if these are too few or one of the two is constant.

    Sources: Spearman (1904), ties share the mean of their ranks. Interval: Fisher's z with the variance
    (1 + rho^2/2) / (n - 3) of Bonett and Wright (2000). p: Student's t with n - 2 degrees of freedom (Kendall and
    Stuart, Advanced Theory of Statistics 2, 31.19). It sees monotonic relations only.
    """
    x, y = parameter(columns, label), value(columns, metric)
    both = ~(np.isnan(x) | np.isnan(y))
    n = int(both.sum())
    if n < MIN_RUNS:
        return None
    x, y = _ranks(x[both]), _ranks_of(columns, metric) if n == np.isfinite(y).sum() else _ranks(y[both])
    if np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        return None
    # takes a while to import, and most of this package does without
    from scipy.special import stdtr

    # ranks less their mean are halves of whole numbers, whose sums are exact: a perfect correlation is exactly 1
    x, y = x - 0.5 * (n + 1), y - 0.5 * (n + 1)
    rho = max(-1.0, min(1.0, float(x @ y) / math.sqrt(float(x @ x) * float(y @ y))))
    perfect = abs(rho) == 1.0
    # Fisher's z of a perfect correlation is infinite, and so are both ends
    z = math.copysign(math.inf, rho) if perfect else math.atanh(rho)
    half = _NORMAL_95 * math.sqrt((1.0 + 0.5 * rho * rho) / (n - 3))
    t = math.inf if perfect else abs(rho) * math.sqrt((n - 2) / (1.0 - rho * rho))
    return Correlation(rho, math.tanh(z - half), math.tanh(z + half), float(2.0 * stdtr(n - 2, -t)), n)


@cache_per_columns
def _ranks_of(columns: Columns, metric: str) -> Numbers:
    """Of the runs that have the metric: every parameter is held against it."""
    numbers = value(columns, metric)
    return _ranks(numbers[~np.isnan(numbers)])


def _ranks(numbers: Numbers) -> Numbers:
    """From 1 on; ties share the mean of theirs."""
    _, which, counts = np.unique(numbers, return_inverse=True, return_counts=True)
    ranks: Numbers = (np.cumsum(counts) - 0.5 * (counts - 1))[which]
    return ranks


Interval = tuple[float, float] | None


@dataclass(frozen=True)
class Index:
    """Indices of one parameter, each with its interval (low, high), made for 95 %; None: there is none.

    How often it holds the true index was counted with functions whose indices are known, see docs/sweep_show.md.

    Attributes:
        first: share of the variance that would go if the parameter were known.
        total: share that would stay if everything else were known; more than `first` where it acts with others.
    """

    label: str
    first: float
    first_interval: Interval
    total: float
    total_interval: Interval


@dataclass(frozen=True)
class Indices:
    """What a drive's rows say.

    Attributes:
        of: by parameter; empty if there is nothing to say.
        remark: what stands in the way, or how far it holds.
        blocks, planned: blocks of d + 2 runs that are whole, and in the design.
    """

    entries: tuple[Index, ...]
    remark: str
    blocks: int
    planned: int


def sobol_indices(columns: Columns, labels: Sequence[str], runs: int, metric: str) -> Indices:
    """Indices of every parameter, of one drive's rows in a design = "saltelli".

    Args:
        labels: d parameters in the order of the design.
        runs: planned for this drive, blocks of d + 2. Run numbers of the drive are consecutive; the first row of each
            block is where `saltelli_cube` begins one.

    A block with a run that has no number is left out as a whole, since each of its runs counts relative to the others.
    """
    width = len(labels) + 2
    planned = runs // width
    if runs % width:
        # two runs that came out equal are planned once, and then nothing says which block a run belongs to
        return Indices((), f"{runs} runs are no whole blocks of {width}; draw with another seed", 0, planned)
    run = columns.numbers("run").astype(int)
    first = int(run.min()) if len(run) else 1
    # rows may be missing, their drive's first one too: blocks of all drives are equally many
    start = first - (first - 1) % runs
    block, place = np.divmod(run - start, width)
    # of another drive, somebody has changed the rows
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
    """First-order and total indices, (..., d) each.

    Sources: Saltelli et al. (2010), Table 2: (b) for the first order, (f) after Jansen (1999) for the total. Values are
    centred before, which leaves the indices what they are and their error smaller.

    Args:
        f_A, f_B: (..., n).
        f_AB: (..., d, n), column i of A replaced by that of B.
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
    """Of whole blocks (n, d + 2)."""
    first, total = estimates(blocks[:, 0], blocks[:, 1], blocks[:, 2:].T)
    halves = half_widths(blocks) if len(blocks) >= MIN_INTERVAL_BLOCKS else np.full((2, len(labels)), np.nan)

    def around(index: float, half: float) -> Interval:
        return (index - half, index + half) if np.isfinite(half) else None

    return tuple(
        Index(label, F, around(F, half_F), T, around(T, half_T))
        for label, F, T, half_F, half_T in zip(
            labels, first.tolist(), total.tolist(), *halves.tolist(), strict=True
        )
    )  # fmt: skip


def half_widths(blocks: Numbers) -> Numbers:
    """Half of the interval around each first-order and total index, (2, d), of whole blocks (n, d + 2).

    Student's t at 0.975 with n - 1 degrees of freedom, times the jackknife's standard error: that of the indices
    without one block each (Efron and Tibshirani 1993, Eq. 11.5). NaN where all blocks but one are equal.
    """
    # takes a while to import, and most of this package does without
    from scipy.special import stdtrit

    n = len(blocks)
    mean = blocks[:, :2].mean()
    a, b, change = blocks[:, 0, None] - mean, blocks[:, 1, None] - mean, blocks[:, 2:] - blocks[:, :1]

    def without(each: Numbers) -> Numbers:
        """Means of all rows but one, (n, ..), of those that are left out in turn."""
        return (each.sum(axis=0) - each) / (n - 1)

    middle = 0.5 * without(a + b)
    variance = 0.5 * without(a**2 + b**2) - middle**2
    with np.errstate(invalid="ignore", divide="ignore"):
        first = (without(b * change) - middle * without(change)) / variance
        total = 0.5 * without(change**2) / variance
    return np.array([stdtrit(n - 1, 0.975) * np.sqrt((n - 1) * each.var(axis=0)) for each in (first, total)])


def why_no_indices(design: str) -> str:
    """The sentence for a design that allows no indices; "" for one that does."""
    if design == "saltelli":
        return ""
    return f'no Sobol indices: they need design = "saltelli", this is "{design}"; rank correlations need no design'
