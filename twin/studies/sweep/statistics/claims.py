"""What the claims of the paper come to over all runs, and the bands of their curves."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.kernel.errors import InputRefused
from twin.studies.metrics.response import Curve
from twin.studies.paper.claim import Claim
from twin.studies.sweep.rows import ROWS, Columns, Row, once
from twin.studies.sweep.statistics.ranking import QUANTILES

HOLDS, FAILS = ("holds", "reproduced after all"), ("fails", "not reproduced")
"""Verdicts: of a draw it is asked whether a claim holds, not whether that was known."""


@dataclass(frozen=True)
class Likelihood:
    """A claim in a sweep.

    Attributes:
        claim: what is claimed.
        holds, judged: runs; a run in which it is trivial is not judged.
        trivial: runs that say nothing about it.
        interval: 95 % interval of the probability that it holds.
        quantiles: of the number measured, in the claim's unit, at `QUANTILES`; infinity where it never happens.
    """

    claim: Claim
    holds: int
    judged: int
    trivial: int
    interval: tuple[float, float]
    quantiles: tuple[float, ...]

    @property
    def share(self) -> float:
        """Of the judged runs, those in which it holds; nan if there are none."""
        return self.holds / self.judged if self.judged else float("nan")


@once
def likelihoods(columns: Columns) -> list[Likelihood]:
    """Every claim that some run was asked for, in the order of the paper; runs that failed are not among the judged."""
    judged = columns.under("verdicts")
    if not judged:
        return []
    # takes a while to import, and few sweeps judge claims
    from twin.studies.paper.fig4 import CLAIMS, QUALITY

    found = []
    for claim in (*CLAIMS, *QUALITY):
        if claim.key not in judged:
            continue
        verdicts = columns.words(f"verdicts/{claim.key}")
        numbers = columns.numbers(f"values/{claim.key}")[verdicts.are(lambda verdict: verdict is not None)]
        if not len(numbers):
            continue
        holds, fails = (sum(verdicts.counts.get(one, 0) for one in either) for either in (HOLDS, FAILS))
        numbers = np.where(np.isnan(numbers), np.inf, numbers)
        # between two runs there may be infinity: a quantile is the number of a run
        quantiles = np.quantile(numbers, QUANTILES, method="inverted_cdf")
        interval = wilson_interval(holds, holds + fails)
        trivial = len(numbers) - holds - fails
        found.append(Likelihood(claim, holds, holds + fails, trivial, interval, tuple(map(float, quantiles))))
    return found


def wilson_interval(successes: int, runs: int) -> tuple[float, float]:
    """95 % interval of a probability, inside 0 .. 1 also where all runs or none succeed; (0, 1) of no runs.

    Source: Wilson (1927); recommended for small numbers by Brown, Cai and DasGupta (2001).
    """
    # as above
    from scipy.stats import binomtest

    if runs == 0:
        return 0.0, 1.0
    interval = binomtest(successes, runs).proportion_ci(0.95, "wilson")
    return float(interval.low), float(interval.high)


@dataclass(frozen=True)
class Bands:
    """Of `runs` runs: `bands["position.F_z"]` is (quantiles, n) at the times `t` (s); m and N.

    Quantiles belong to each time alone: no single run need follow one.
    """

    t: Curve
    quantiles: dict[str, Curve]
    runs: int

    def __getitem__(self, name: str) -> Curve:
        if name not in self.quantiles:
            raise InputRefused(f"{ROWS}: no run kept its curve {name}; run the sweep anew in another --out")
        return self.quantiles[name]


def bands(rows: Sequence[Row]) -> Bands | None:
    """Over the runs that kept curves; None if none did.

    Raises:
        InputRefused: curves of a run that twin sweep does not write, or other ones than those of the runs before.
    """
    # judging takes a while to import, and few sweeps have claims
    from twin.studies.sweep.fig4 import unpacked

    kept = []
    for row in rows:
        if not row.get("curves"):
            continue
        try:
            kept.append(unpacked(row["curves"]))
        except ValueError as problem:
            raise _odd(row) from problem
        (t, first), (now, curves) = kept[0], kept[-1]
        if len(now) != len(t) or curves.keys() != first.keys():
            raise _odd(row)
    if not kept:
        return None
    quantiles = {name: np.quantile([values[name] for _, values in kept], QUANTILES, axis=0) for name in first}
    return Bands(t, quantiles, len(kept))


def _odd(row: Row) -> InputRefused:
    return InputRefused(
        f"{ROWS}: run {row['run']} has curves that are none, or not those of the other runs; remove its line, the run "
        "is then done again"
    )
