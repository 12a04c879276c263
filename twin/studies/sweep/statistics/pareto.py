"""What trades off: runs that no other beats in two metrics at once."""

import math
from collections.abc import Sequence

from twin.studies.sweep.rows import Row
from twin.studies.sweep.statistics.ranking import best, value


def pareto_front(rows: Sequence[Row], one: str, other: str) -> list[Row]:
    """Of the runs that `best` would rank by `one` and that have `other`, those that no other beats; least `one` first.

    A run beats another if it has no more of either metric and less of one of them.
    """
    both = [row for row in best(rows, one) if not math.isnan(value(row, other))]
    front: list[Row] = []
    least = math.inf
    for row in sorted(both, key=lambda row: (value(row, one), value(row, other))):
        same = front and all(value(row, metric) == value(front[-1], metric) for metric in (one, other))
        if value(row, other) < least or same:
            front.append(row)
            least = value(row, other)
    return front
