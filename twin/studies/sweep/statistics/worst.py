"""What each choice comes to where it is worst: the largest of a metric over a parameter that nobody can choose."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin.studies.sweep.columns import Columns, Positions, Words
from twin.studies.sweep.statistics.ranking import best, value


@dataclass(frozen=True)
class Worst:
    """The runs of one choice of all other parameters and of the drive.

    Attributes:
        row: of the worst run.
        metric: of that run; infinity if it failed, tripped, broke a limit or has no number.
        runs: of this choice.
        bad: how many of them have no number that counts.
    """

    row: int
    metric: float
    runs: int
    bad: int


def worst_over(columns: Columns, metric: str, label: str, labels: Sequence[str]) -> list[Worst]:
    """For each choice of the other parameters its worst run over `label`, least worst first, ties in order of rows.

    Args:
        metric: less is better.
        labels: of all parameters that vary.
    """
    if not len(columns):
        return []
    others = [columns.of[name] for one in labels if one != label and (name := f"parameters/{one}") in columns.of]
    keys = [found.codes if isinstance(found, Words) else np.unique(found, return_inverse=True)[1] for found in others]
    keys.append(columns.words("drive").codes)
    _, group = np.unique(np.column_stack(keys), axis=0, return_inverse=True)
    group = group.reshape(-1)
    numbers = np.full(len(columns), np.inf)
    counting = best(columns, metric)
    numbers[counting] = value(columns, metric)[counting]
    # of each group the largest number, of equal ones the first row
    order = np.lexsort((-np.arange(len(columns)), numbers, group))
    last: Positions = order[np.flatnonzero(np.diff(group[order], append=-1))]
    runs, bad = np.bincount(group), np.bincount(group, np.isinf(numbers))
    found = [Worst(int(row), float(numbers[row]), int(runs[group[row]]), int(bad[group[row]])) for row in last]
    return sorted(found, key=lambda one: (one.metric, one.row))
