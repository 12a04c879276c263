"""Bands of the curves that runs kept: at each time the quantiles over all runs."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.errors import InputRefused
from twin.studies.metrics.response import Curve
from twin.studies.sweep.columns import Row
from twin.studies.sweep.curves import unpacked
from twin.studies.sweep.rows import ROWS
from twin.studies.sweep.statistics.distribution import QUANTILES


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
