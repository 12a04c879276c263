"""Rows and events of several slices, put together again before they are recorded.

A recording's chunks end where its blocks do. A paced run is sliced finer than one that runs freely; in blocks of one
size both give the same bytes.
"""

import numpy as np

from twin.runs.observer import TickEvent


class RowBlock:
    """Rows of consecutive ticks, and what happened in them.

    Args:
        size: most rows.
        width: of a row.

    Attributes:
        first: tick of the first row.
        events: in the order in which they were added.
    """

    def __init__(self, size: int, width: int):
        self.first = 0
        self.events: list[TickEvent] = []
        self._memory = np.empty((size, width))
        self._count = 0

    @property
    def rows(self) -> np.ndarray:
        """(n, width), a view that `clear` gives up."""
        return self._memory[: self._count]

    @property
    def full(self) -> bool:
        return self._count == len(self._memory)

    def add(self, rows: np.ndarray, events: list[TickEvent]) -> None:
        """Append the `rows` of one slice, no more than there is room for, and its `events`."""
        self._memory[self._count : self._count + len(rows)] = rows
        self._count += len(rows)
        self.events += events

    def clear(self) -> None:
        """Begin the next block at the tick after the last row."""
        self.first += self._count
        self._count = 0
        self.events = []
