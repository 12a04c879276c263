"""Bands of the curves that runs kept: at each time the quantiles over all runs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.metrics.response import Curve
from twin.sweep.curves import unpacked
from twin.sweep.rows import Row
from twin.sweep.statistics.distribution import QUANTILES


@dataclass(frozen=True)
class Bands:
    """Of `runs` runs: `bands["position.F_z"]` is (quantiles, n) at the times `t` (s); m and N.

    Quantiles belong to each time alone: no single run need follow one.
    """

    t: Curve
    quantiles: dict[str, Curve]
    runs: int

    def __getitem__(self, name: str) -> Curve:
        return self.quantiles[name]


def bands(rows: Sequence[Row]) -> Bands | None:
    """Over the runs that kept curves; None if none did."""
    kept = [unpacked(row["curves"]) for row in rows if row.get("curves")]
    if not kept:
        return None
    t, first = kept[0]
    quantiles = {name: np.quantile([values[name] for _, values in kept], QUANTILES, axis=0) for name in first}
    return Bands(t, quantiles, len(kept))
