"""How likely the paper's claims are when the plant is not what the controller believes."""

import math
from collections.abc import Sequence

import numpy as np

from twin.studies.sweep.folder import KeptRows
from twin.studies.sweep.show.table import Part
from twin.studies.sweep.show.words import interval, number
from twin.studies.sweep.statistics.claims import Likelihood, likelihoods
from twin.studies.sweep.statistics.distribution import QUANTILES

LIKELY = 0.95
"""Share of runs from which on a claim is called likely."""
MEDIAN = QUANTILES.index(0.5)


def least_sure(found: Sequence[Likelihood]) -> str:
    """`17 of 20 claims hold in 95 % of the runs; least sure is 'F_z stays lower' (41 %)`."""
    judged = [one for one in found if one.judged]
    if not judged:
        return "no claim could be judged"
    likely = sum(one.share >= LIKELY for one in judged)
    least = min(judged, key=lambda one: one.share)
    text = f"{likely} of {len(judged)} claims hold in at least {100 * LIKELY:g} % of the runs"
    return text if least.share >= LIKELY else f"{text}; least sure: {least.claim.key} ({100 * least.share:.0f} %)"


def claims_part(kept: KeptRows) -> Part | None:
    """Each claim with the probability that it holds; None if none was asked for."""
    found = likelihoods(kept.columns)
    if not found:
        return None
    head = ["claim", "holds in", "P, 95 %", "expected", "median", "5 to 95 %"]
    lines = [
        [
            one.claim.key,
            f"{one.holds} of {one.judged}",
            interval(one.interval) if one.judged else "-",
            f"{one.claim.expected} {one.claim.unit}".rstrip(),
            _measured(one, MEDIAN),
            f"{_measured(one, 0)} .. {_measured(one, -1)}",
        ]
        for one in found
    ]
    columns = kept.columns
    verdicts = (columns.words(name) for name in columns.under("verdicts").values())
    judged = int(np.any([one.are(lambda verdict: verdict is not None) for one in verdicts], axis=0).sum())
    remarks = ["P: Wilson interval. true_...: not the paper's but ours, on the true force"]
    if missing := len(columns) - judged:
        remarks.append(f"{missing} of {len(columns)} runs came to no end and are not judged: reasons below")
    remarks += [f"{one.claim.key}: trivial in {one.trivial} runs, not counted" for one in found if one.trivial]
    return Part(
        "claims",
        f"claims of Fig. 4 over {judged} runs",
        head,
        lines,
        remarks,
        {one.claim.key: one.claim.text for one in found},
    )


def _measured(one: Likelihood, quantile: int) -> str:
    value = one.quantiles[quantile]
    return number(value) if not math.isfinite(value) else f"{value:.{one.claim.digits}f}"
