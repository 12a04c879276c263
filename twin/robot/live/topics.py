"""Messages of a run for viewers: its rows as topics, its drawings, its events."""

from collections.abc import Iterable, Iterator, Sequence
from typing import Protocol

import numpy as np

from twin.kernel.cosim.observers import TickEvent
from twin.kernel.live import Channel, Message
from twin.kernel.recording.messages import (
    HEAD_SIZE,
    VALUE_TYPES,
    Kind,
    MessageForm,
    form_filling,
    log_message,
    message_layout,
)
from twin.kernel.recording.recorder import RowStream
from twin.kernel.recording.writer import EVENTS_TOPIC, NS_PER_S, declarations
from twin.robot.scene import Drawing


class SceneSource(Protocol):
    """Interface of a source of 3D drawings for a live viewer, with their message forms."""

    @property
    def forms(self) -> Sequence[MessageForm]: ...

    def drawings(self, first: int, rows: np.ndarray, /) -> Iterable[Drawing]:
        """Return the drawings for `rows` (n, width) from tick `first` on; at tick 0 everything is drawn."""


class Topics:
    """Channels of a run for live viewers and their messages, with the names, schemas and units of the recording.

    There is a channel for each stream, in order, then for each topic of the scene (`/scene`, `/tf`, `/force` ...), then
    `/events`.
    See `twin.robot.run.viewer.Viewer.begin` for the arguments.
    """

    def __init__(self, streams: Sequence[RowStream], scene: SceneSource, tick: float):
        self._encoder, self._scene, self._tick = MessageEncoder(streams), scene, tick
        self._layouts = {form.name: form_filling(0, form) for form in scene.forms}
        constant = {form.name for form in scene.forms if form.width == 0}
        self.channels = tuple(
            Channel(number, f"/{name}", kind, descriptors, meanings, name in constant)
            for number, (name, kind, descriptors, meanings) in enumerate(
                declarations([stream.topic for stream in streams], scene.forms), start=1
            )
        )
        self._numbers = {channel.topic[1:]: channel.number for channel in self.channels}
        self._drawn = {self._numbers[name] for name in self._layouts}

    def time(self, tick: int) -> int:
        """Return the simulated time of `tick` in ns; like the recording it starts at 0."""
        return round(tick * (self._tick * NS_PER_S))

    def messages(
        self, tick: int, row: np.ndarray, events: Sequence[TickEvent], wanted: frozenset[int], lacking: frozenset[int]
    ) -> Iterator[Message]:
        """Yield the viewer messages of one row of a run and of its events.

        `wanted` are channels with a subscriber, as unseen drawings are skipped; `lacking` are constant channels.
        """
        for event in events:
            time = self.time(event.tick)
            yield Message(self._numbers[EVENTS_TOPIC], time, log_message(time, event.level, event.text, event.source))
        time = self.time(tick)
        # sampled outputs stay valid until the next sample, so the whole row is valid now
        for channel, content in zip(self.channels, self._encoder.messages(row), strict=False):
            yield Message(channel.number, time, content)
        if wanted.isdisjoint(self._drawn):
            return
        # at tick 0 everything is drawn
        for name, _, rows in self._scene.drawings(0, row[None, :]):
            if rows.shape[1] > 0 or self._numbers[name] in lacking:
                record = self._layouts[name].records(np.array([time]), 0, rows)
                yield Message(self._numbers[name], time, record[0, HEAD_SIZE:].tobytes())


class MessageEncoder:
    """Encoder of a row of all recorded signals as protobuf messages.

    The layout is the recording's: every number has a fixed place in its message (`recording/messages.py`). So all
    messages share one buffer, and a row is copied into it by three assignments, one per kind of number, independent of
    the number of topics and fields.
    """

    def __init__(self, streams: Sequence[RowStream]):
        messages = []
        columns: dict[Kind, list[int]] = {kind: [] for kind in VALUE_TYPES}
        places: dict[Kind, list[int]] = {kind: [] for kind in VALUE_TYPES}
        end = 0
        self._spans = []
        for stream in streams:
            layout = message_layout(0, stream.topic.fields)
            offsets = dict(layout.values.fields or {})
            column = stream.columns.start
            for field in stream.topic.fields:
                start = end - HEAD_SIZE + offsets[field.name][1]
                length = VALUE_TYPES[field.kind].itemsize
                columns[field.kind] += range(column, column + field.size)
                places[field.kind] += range(start, start + field.size * length)
                column += field.size
            messages.append(layout.filling.template[HEAD_SIZE:])
            self._spans.append((end, end := end + len(messages[-1])))
        self._bytes = np.concatenate(messages)
        self._columns = {kind: np.array(found, dtype=np.intp) for kind, found in columns.items()}
        self._places = {kind: np.array(found, dtype=np.intp) for kind, found in places.items()}

    def messages(self, row: np.ndarray) -> Iterator[bytes]:
        """Yield the protobuf message of each stream for one row of all outputs of the system."""
        for kind, columns in self._columns.items():
            self._bytes[self._places[kind]] = row[columns].astype(VALUE_TYPES[kind]).view(np.uint8)
        content = self._bytes.tobytes()
        return (content[start:end] for start, end in self._spans)
