"""An observer that records a simulation.

Rows and events of several slices are joined into blocks of one size before they are recorded, because a recording's
chunks end at its blocks: so a paced run, whose slices are finer, gives the same bytes as a free-running one.
"""

import platform
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import Any, get_args

import numpy as np

from twin.kernel.cosim.observers import Level, Observer, TickEvent
from twin.kernel.cosim.port import Port
from twin.kernel.cosim.simulation import Simulation
from twin.kernel.cosim.state import decode_json, encode_json
from twin.kernel.errors import ComponentFailed, EndRequest
from twin.kernel.recording.messages import Field, Topic
from twin.kernel.recording.writer import Writer

Drawings = Callable[[int, np.ndarray], Iterable[tuple[Any, ...]]]
BLOCK_TICKS = 100


@dataclass(frozen=True)
class RowStream:
    """A topic of a recording, and the columns of a simulation's output row with its values."""

    topic: Topic
    columns: slice


def versions() -> dict[str, str]:
    """Return the versions of Python and of the packages that a recording depends on."""
    packages = ("twin", "numpy", "numba", "llvmlite", "fmpy", "mcap")
    return {"python": platform.python_version(), **{name: version(name) for name in packages}}


class RowBlock:
    """A block of output rows of consecutive ticks from `first`, and the events during them, collected for writing."""

    def __init__(self, size: int, width: int, first: int = 0):
        self.first = first
        self.events: list[TickEvent] = []
        self._memory = np.empty((size, width))
        self._count = 0

    @property
    def rows(self) -> np.ndarray:
        """Collected rows of the block, (n, width)."""
        return self._memory[: self._count]

    @property
    def is_full(self) -> bool:
        return self._count == len(self._memory)

    def add(self, rows: np.ndarray, events: list[TickEvent]) -> None:
        """Append the rows of one slice to the block, at most the remaining room, and its events."""
        self._memory[self._count : self._count + len(rows)] = rows
        self._count += len(rows)
        self.events += events


def port_fields(ports: Iterable[Port]) -> tuple[Field, ...]:
    """Return the fields of a recorded message with the values of `ports`."""
    return tuple(Field(port.name, port.size, port.kind, port.unit, port.meaning) for port in ports)


class EventLog(Observer):
    """Observer of a simulation that collects all events in `events`."""

    def __init__(self) -> None:
        self.events: list[TickEvent] = []

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        self.events += events

    def state(self) -> Any:
        return encode_json(self.events)

    def restore(self, state: Any) -> None:
        self.events = [TickEvent(*one) for one in decode_json(state, "events")]
        for event in self.events:
            if [type(value) for value in event] != [int, str, str, str] or event.level not in get_args(Level):
                raise ValueError(f"{event} is not an event")


class Recorder(EventLog):
    """Observer that records a run: passes rows, drawings and events to `writer`, block by block.

    `drawings` returns (topic, tick, rows) of each drawing for the tick of a block's first row and its rows. `changed`
    returns the first manual change during the run, "" before it, recorded as metadata. `writing` is the wall time spent
    (s). `block` is the number of ticks written together. With `background`, a thread of its own writes: in a paced run
    a block takes longer than a tick.
    """

    def __init__(
        self,
        writer: Writer,
        streams: Sequence[RowStream],
        drawings: Drawings = lambda first, rows: (),
        changed: Callable[[], str] = str,
        background: bool = False,
        block: int = BLOCK_TICKS,
    ):
        super().__init__()
        self._block_ticks = block
        self._queue: SimpleQueue[Callable[[Writer], None] | None] = SimpleQueue()
        self._failure: BaseException | None = None
        self.thread = Thread(target=self._work, name="recorder", daemon=True) if background else None
        if self.thread:
            self.thread.start()
        self.writing = 0.0
        self._writer, self._streams, self._drawings, self._changed = writer, streams, drawings, changed
        self._marked = False

    def begin(self, simulation: Simulation) -> None:
        self._simulation = simulation
        self._block = self._new_block(simulation.next_tick)

    def ready(self, tick: int) -> None:
        if not self._marked and (first := self._changed()):
            # the experiment alone does not reproduce this run
            self.call(
                lambda writer: writer.write_metadata("changed", {"first": first, "all": "the events of 'tuning'"})
            )
            self._marked = True

    def on_rows(self, first: int, rows: np.ndarray, events: list[TickEvent]) -> None:
        began = time.perf_counter()
        super().on_rows(first, rows, events)
        self._block.add(rows, events)
        if self._block.is_full or self._simulation.is_over:
            self._end_block()
        self.writing += time.perf_counter() - began

    def stop(self) -> None:
        """Wait for all writes in the background and end the thread; no effect without one."""
        if self.thread and self.thread.is_alive():
            self._queue.put(None)
            self.thread.join()

    def call(self, write: Callable[[Writer], None]) -> None:
        """Call `write` with the writer after all earlier writes, in the thread if any; raise an earlier error."""
        if self._failure is not None:
            raise self._failure
        if self.thread:
            self._queue.put(write)
        else:
            write(self._writer)

    def attach(self, tick: int, content: bytes, media_type: str) -> None:
        """Write an attachment to the recording for the beginning of `tick`, after all earlier rows."""
        began = time.perf_counter()
        self._end_block()
        self.call(lambda writer: writer.write_attachment(f"state_{tick}", tick, media_type, content))
        self.writing += time.perf_counter() - began

    def finish(self) -> Path:
        began = time.perf_counter()
        # empty unless an observer ended the run in the middle of a block
        self._end_block()
        self._join()
        recording = self._writer.finish()
        self.writing += time.perf_counter() - began
        return recording

    def end(self, request: EndRequest) -> None:
        """Record as an event that a component requested the end of the run."""
        event = TickEvent(max(0, self._simulation.next_tick - 1), "INFO", str(request), self._simulation.culprit)
        self.events.append(event)
        self.call(lambda writer: writer.write_event(event.tick, event.level, event.text, event.source))

    def abandon(self, failure: ComponentFailed) -> str:
        """Record `failure` as the last event, close the recording unfinished, and return a message about both."""
        self._join()
        end = self._simulation.next_tick
        self._writer.write_event(end, "ERROR", str(failure), "cosim")
        until = max(0, end - 1) * self._simulation.system.tick
        return f"{failure}\nRecorded until then: {self._writer.abandon()} ({until:.3f} s)."

    def _new_block(self, first: int) -> RowBlock:
        return RowBlock(self._block_ticks, self._simulation.system.outputs_width, first)

    def _end_block(self) -> None:
        """Write the present block, and begin the next one."""
        block = self._block
        if not len(block.rows) and not block.events:
            return
        self.call(lambda writer: self._write_block(block))
        self._block = self._new_block(block.first + len(block.rows))

    def _work(self) -> None:
        """Execute queued writes until the end, or until one fails."""
        try:
            while (write := self._queue.get()) is not None:
                write(self._writer)
        except BaseException as problem:
            self._failure = problem

    def _join(self) -> None:
        """Wait for all writes in the background, and raise the exception of one that failed."""
        self.stop()
        if self._failure is not None:
            raise self._failure

    def _write_block(self, block: RowBlock) -> None:
        for stream in self._streams:
            start = -block.first % stream.topic.period
            rows = block.rows[start :: stream.topic.period, stream.columns]
            self._writer.write(stream.topic.name, block.first + start, rows)
        for drawing in self._drawings(block.first, block.rows):
            self._writer.write(*drawing)
        for event in block.events:
            self._writer.write_event(event.tick, event.level, event.text, event.source)
        # write now: the next slice may crash this process
        self._writer.end_slice()
