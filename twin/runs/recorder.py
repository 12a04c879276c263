"""An observer that writes a run's recording.

What components are called in a recording, in a viewer and in memory.

Rows and events of several slices, put together again before they are recorded. A recording's chunks end where its
blocks do. A paced run is sliced finer than one that runs freely; in blocks of one size both give the same bytes.
"""

import re
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin.cosim.simulation import Simulation
from twin.cosim.system import System
from twin.errors import ComponentFailed
from twin.recording.layout import Field, Topic
from twin.recording.writer import Writer
from twin.runs.loop import Observer, TickEvent
from twin.runs.scene.scene import Scene
from twin.runs.tuning import Tuning


@dataclass(frozen=True)
class RowStream:
    """A topic, and the columns of a row that it is made of."""

    topic: Topic
    columns: slice


def streams_of(system: System, shortest: int = 1) -> list[RowStream]:
    """One per component, in their order.

    `drive_1` is the topic drive/1, `fault_1` is fault/1, everything else has its own name.

    Args:
        shortest: ticks from one message to the next, at least.
    """
    streams = []
    for c, component in enumerate(system.components):
        name = re.sub(r"^(drive|fault)_", r"\1/", component.name)
        fields = tuple(Field(p.name, p.size, p.kind, p.unit, p.meaning) for p in component.outputs)
        columns = slice(int(system.y_start[c]), int(system.y_start[c + 1]))
        streams.append(RowStream(Topic(name, fields, max(shortest, component.period)), columns))
    return streams


def fields_of(system: System) -> dict[str, Field]:
    """`topic.field` -> the field, of all that a recording of `system` has."""
    return {f"{s.topic.name}.{field.name}": field for s in streams_of(system) for field in s.topic.fields}


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

    def abandon(self, failure: ComponentFailed) -> str:
        """`failure`, which becomes the last event of the recording, and how far that goes."""
        end = self._simulation.next_tick
        self._writer.write_event(end, "ERROR", str(failure), "cosim")
        until = max(0, end - 1) * self._simulation.system.tick
        return f"{failure}\nRecorded until then: {self._writer.abandon()} ({until:.3f} s)."

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
