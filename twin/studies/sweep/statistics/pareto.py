"""What trades off: runs that no other beats in two metrics at once."""

import math
from collections.abc import Sequence
from operator import itemgetter

from twin.studies.sweep.rows import Row
from twin.studies.sweep.statistics.ranking import best, value


def pareto_front(rows: Sequence[Row], one: str, other: str) -> list[Row]:
    """Of the runs that `best` would rank by `one` and that have `other`, those that no other beats; least `one` first.

    A run beats another if it has no more of either metric and less of one of them.
    """
    both = [(value(row, one), value(row, other), row) for row in best(rows, one)]
    front: list[Row] = []
    last, least = (math.nan, math.nan), math.inf
    for a, b, row in sorted((found for found in both if not math.isnan(found[1])), key=itemgetter(0, 1)):
        if b < least or (a, b) == last:
            front.append(row)
            last, least = (a, b), b
    return front
