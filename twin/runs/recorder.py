"""An observer that writes a run's recording."""

import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twin.cosim.simulation import Simulation
from twin.errors import ComponentFailed
from twin.recording.writer import Writer
from twin.runs.block import RowBlock
from twin.runs.observer import Observer, TickEvent
from twin.runs.scene.scene import Scene
from twin.runs.streams import RowStream
from twin.runs.tuning import Tuning

BLOCK_TICKS = 100


class Recorder(Observer):
    """Hands rows, drawings and events to `writer`, a block at a time.

    Args:
        streams: whose topics, and `scene`, whose forms `writer` has.
        scene: None: nothing is drawn.
        tuning: whose first change by hand the recording's metadata tell; an observer before this one. None: nothing
            can be changed.

    Attributes:
        events: all of them.
        writing: wall time spent in here (s).
    """

    def __init__(
        self,
        writer: Writer,
        streams: Sequence[RowStream],
        scene: Scene | None = None,
        tuning: Tuning | None = None,
    ):
        self.events: list[TickEvent] = []
        self.writing = 0.0
        self._writer, self._streams, self._scene, self._tuning = writer, streams, scene, tuning
        self._marked = False

    def begin(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._block = RowBlock(BLOCK_TICKS, simulation.system.outputs_width)

    def ready(self, tick: int) -> None:
        if self._tuning and self._tuning.first and not self._marked:
            # whoever repeats the experiment will not get this run
            self._writer.write_metadata("changed", {"first": self._tuning.first, "all": "the events of 'tuning'"})
            self._marked = True

    def take(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        began = time.perf_counter()
        self.events += events
        self._block.add(rows, events)
        if self._block.full or self._simulation.finished:
            self._write()
        self.writing += time.perf_counter() - began

    def finish(self) -> Path:
        """The finished recording.

        Raises:
            RecordingFailed: the disk is full.
        """
        began = time.perf_counter()
        recording = self._writer.finish()
        self.writing += time.perf_counter() - began
        return recording

    def abandon(self, failure: ComponentFailed) -> Path:
        """The recording as far as it goes, with `failure` as its last event."""
        self._writer.write_event(self._simulation.next_tick, "ERROR", str(failure), "cosim")
        return self._writer.abandon()

    def _write(self) -> None:
        block = self._block
        for stream in self._streams:
            start = -block.first % stream.topic.period
            rows = block.rows[start :: stream.topic.period, stream.columns]
            self._writer.write(stream.topic.name, block.first + start, rows)
        for drawing in self._scene.drawings(block.first, block.rows) if self._scene else ():
            self._writer.write(*drawing)
        for event in block.events:
            self._writer.write_event(event.tick, event.level, event.text, event.source)
        # a component may take this process with it in the next slice
        self._writer.end_slice()
        block.clear()
