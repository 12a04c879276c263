"""How likely each claim of the paper is, over the runs that were judged."""

from dataclasses import dataclass

import numpy as np

from twin.studies.paper.claim import Claim
from twin.studies.sweep.columns import Columns, once
from twin.studies.sweep.statistics.distribution import QUANTILES

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
