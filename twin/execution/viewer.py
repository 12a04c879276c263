"""Whoever watches a run while it goes on: what a run asks of one."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from twin.execution.tuning import Tuning
from twin.execution.watch import Event
from twin.recording.layout import Topic
from twin.scene.scene import Scene


@dataclass(frozen=True)
class Stream:
    """A recorded topic, and the columns of a row that it is made of."""

    topic: Topic
    columns: slice


class Viewer(Protocol):
    """Called by the thread that steps, between slices; what it takes its time over delays the run."""

    def begin(self, streams: Sequence[Stream], scene: Scene, tick: float, tuning: Tuning) -> None:
        """A run begins as soon as this returns.

        Args:
            streams: in the order of the recording. scene: draws rows. tick: duration of a tick (s).
            tuning: what may be changed, by any thread, until the run is over.
        """

    def show(self, first: int, rows: np.ndarray, events: Sequence[Event]) -> None:
        """Show what has just been simulated.

        Args:
            first: tick of the first row. rows: (n, width of the system's outputs), overwritten by the next slice.
            events: what happened in them.
        """
