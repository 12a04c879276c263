"""Live viewer of a running simulation, and real-time pacing of a run."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np

from twin.kernel.cosim.deadlines import MIN_WAIT, Deadlines, clock_functions
from twin.kernel.cosim.observers import Observer, TickEvent
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.recording.messages import Topic
from twin.kernel.recording.recorder import Recorder, RowStream
from twin.robot.run.tuning import Tuning
from twin.robot.scene import Scene

if TYPE_CHECKING:
    from twin.robot.remote import RemoteLink

SLICE_TIME, SERVED_SLICE_TIME = 0.01, 0.25
"""Wall time (s) of a slice of a paced run: short for a user who turns a knob, long compared with its overhead. In a
served run, whose samples the Python code between two slices may delay, it is longer."""
SERVED_WAIT = 2e-4
"""Minimum wall time between two deadlines of a served run (s): commands act at the tick after their arrival."""


class Viewer(Protocol):
    """Interface of a live viewer, called between slices by the thread that steps; slow calls delay the run."""

    def begin(self, streams: Sequence[RowStream], scene: Scene, tick: float, tuning: Tuning) -> None:
        """Prepare a live viewer for a run, which begins when this method returns.

        Args:
            streams: recorded streams, in the order of the recording.
            tick: duration of a tick (s).
            tuning: tunable parameters, usable by any thread until the run is over.
        """

    def show(self, first: int, rows: np.ndarray, events: Sequence[TickEvent]) -> None:
        """Show the latest slice of the run to the live viewer: rows (n, width) from tick `first` on.

        The next slice overwrites the rows.
        """


class RemoteSide(Protocol):
    """Interface of the remote side of a served run: a link to the remote controller, recorded topics and metadata."""

    link: "RemoteLink"
    topics: Sequence[Topic]
    metadata: Mapping[str, str]

    def observers(self, recorder: Recorder, deadlines: Deadlines | None) -> Sequence[Observer]:
        """Create the observers of a served run, which the run calls before its own, with its recorder of `topics`.

        `deadlines` is None in lockstep.
        """


class ViewerObserver(Observer):
    """Observer that passes a run to a live viewer."""

    def __init__(self, viewer: Viewer, streams: Sequence[RowStream], scene: Scene, tuning: Tuning):
        self._viewer, self._streams, self._scene, self._tuning = viewer, streams, scene, tuning

    def begin(self, simulation: Simulation) -> None:
        self._viewer.begin(self._streams, self._scene, simulation.system.tick, self._tuning)

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        self._viewer.show(first, rows, events)


@dataclass(frozen=True)
class Punctuality:
    """Statistics on how punctually a run in real time met its deadlines.

    Attributes:
        factor, achieved: requested and achieved simulated time per wall time.
        worst: longest delay of a missed deadline (s).
        jitter, jitter_99: standard deviation and 99th percentile of the wake-up delay after a deadline (s).
    """

    factor: float
    achieved: float
    deadlines: int
    misses: int
    worst: float
    jitter: float
    jitter_99: float

    @property
    def sentence(self) -> str:
        """Summary of the deadlines as text of less than 80 columns."""
        missed = f"{self.misses} of {self.deadlines} deadlines missed"
        if self.misses:
            missed += f", by {1e3 * self.worst:.1f} ms at most"
        return f"{self.achieved:.4g} x real time; {missed}; jitter {1e3 * self.jitter:.2f} ms"


class Pace(Observer):
    """Observer that paces a simulation at `factor` times real time, > 0.

    The simulated `tick`, and the wall time `tick_time` of a tick, are in s. `served`: whether a remote controller
    commands the robot.
    """

    def __init__(self, factor: float, tick: float, served: bool = False):
        self._factor = factor
        self._slice_time, shortest = (SERVED_SLICE_TIME, SERVED_WAIT) if served else (SLICE_TIME, MIN_WAIT)
        self.tick_time = tick / factor
        self.deadlines = Deadlines(self.tick_time, clock_functions(), shortest)

    def slice_ticks(self, block: int) -> int:
        """Return the ticks of a slice of a paced run: a divisor of `block`, at most the slice time, or one."""
        most = max(1, math.floor(self._slice_time / self.tick_time + 1e-9))
        return max(n for n in range(1, block + 1) if n <= most and block % n == 0)

    def begin(self, simulation: Simulation) -> None:
        simulation.pace(self.deadlines)

    def punctuality(self) -> Punctuality:
        """Return the statistics of all real-time deadlines so far."""
        found = self.deadlines.counts
        count, mean = max(1, found["count"]), found["sum"] / max(1, found["count"])
        due = (found["last"] - found["start"]) * self.tick_time if found["count"] else 0.0
        return Punctuality(
            factor=self._factor,
            achieved=self._factor * due / (due + found["newest"]) if due else self._factor,
            deadlines=int(found["count"]),
            misses=int(found["missed"]),
            worst=found["worst"],
            jitter=math.sqrt(max(0.0, found["squares"] / count - mean**2)),
            jitter_99=self.deadlines.lateness.quantile(0.99) if found["count"] else 0.0,
        )
