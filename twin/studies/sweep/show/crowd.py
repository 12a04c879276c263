"""Which dots of a crowd are drawn: a million take seconds, and nearly all of them lie beneath others."""

import numpy as np
from numpy.typing import NDArray

from twin.studies.sweep.columns import Numbers, Positions

CROWD = 50_000
"""Dots up to which all are drawn."""


def visible(x: Numbers, y: Numbers, most: int, cells: int = 150) -> Positions:
    """Positions of the dots to draw, in their order: of a crowd the last `most`, which lie on top, in each cell.

    Args:
        x, y: where the dots are on the paper, in any unit.
        cells: along each axis; of 150 each is smaller than a dot.
    """
    if len(x) <= CROWD:
        return np.arange(len(x))
    cell = _cells(x, cells) * (cells + 1) + _cells(y, cells)
    # of short numbers this takes time with their number alone
    cell = cell.astype(np.min_scalar_type((cells + 1) ** 2))
    order = np.argsort(cell, kind="stable")
    behind = np.searchsorted(cell[order], cell[order], side="right") - np.arange(len(x))
    return np.sort(order[behind <= most])


def _cells(along: Numbers, cells: int) -> NDArray[np.int64]:
    span = np.ptp(along) or 1.0
    return ((along - along.min()) / span * cells).astype(np.int64)
