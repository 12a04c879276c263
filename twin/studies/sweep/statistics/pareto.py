"""What trades off: runs that no other beats in two metrics at once."""

import numpy as np

from twin.studies.sweep.columns import Columns, Positions, once
from twin.studies.sweep.statistics.ranking import best, value


@once
def pareto_front(columns: Columns, one: str, other: str) -> Positions:
    """Of the rows that `best` would rank by `one` and that have `other`, those that no other beats; least `one` first.

    A run beats another if it has no more of either metric and less of one of them.
    """
    rows = best(columns, one)
    rows = rows[~np.isnan(value(columns, other)[rows])]
    a, b = value(columns, one)[rows], value(columns, other)[rows]
    # whoever has more of the other than one with no more of the first is beaten; few are left to be sorted by both
    left = b <= np.minimum.accumulate(b)
    rows, a, b = rows[left], a[left], b[left]
    order = np.lexsort((b, a))
    rows, a, b = rows[order], a[order], b[order]
    before = np.concatenate([[np.inf], np.minimum.accumulate(b)[:-1]])
    first = np.ones(len(rows), bool)
    first[1:] = (a[1:] != a[:-1]) | (b[1:] != b[:-1])
    # of runs that are equal in both the first decides for all
    return rows[(b < before)[first][np.cumsum(first) - 1]] if len(rows) else rows
