"""Whoever watches a run while it goes on: what a run asks of one."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from twin.kernel.cosim.observers import Observer, TickEvent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.recording.recorder import RowStream
from twin.robot.run.tuning import Tuning
from twin.robot.scene.scene import Scene


class Viewer(Protocol):
    """Called by the thread that steps, between slices; what it takes its time over delays the run."""

    def begin(self, streams: Sequence[RowStream], scene: Scene, tick: float, tuning: Tuning) -> None:
        """A run begins as soon as this returns.

        Args:
            streams: in the order of the recording.
            scene: draws rows.
            tick: duration of a tick (s).
            tuning: what may be changed, by any thread, until the run is over.
        """

    def show(self, first: int, rows: np.ndarray, events: Sequence[TickEvent]) -> None:
        """Show what has just been simulated.

        Args:
            first: tick of the first row.
            rows: (n, width of the system's outputs), overwritten by the next slice.
            events: what happened in them.
        """


class Shown(Observer):
    """Shows a run to `viewer`; the arguments are those of its `begin`."""

    def __init__(self, viewer: Viewer, streams: Sequence[RowStream], scene: Scene, tuning: Tuning):
        self._viewer, self._streams, self._scene, self._tuning = viewer, streams, scene, tuning

    def begin(self, simulation: Simulation) -> None:
        self._viewer.begin(self._streams, self._scene, simulation.system.tick, self._tuning)

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        self._viewer.show(first, rows, events)
