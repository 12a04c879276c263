"""What viewers are sent of a run: its rows as messages of topics, and what is drawn of them."""

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
    form_records,
    log_message,
    message_layout,
)
from twin.kernel.recording.recorder import RowStream
from twin.kernel.recording.writer import EVENTS_TOPIC, NS_PER_S, declarations
from twin.robot.scene import Drawing


class SceneSource(Protocol):
    """What draws rows for a viewer, such as `twin.robot.scene.Scene`."""

    @property
    def forms(self) -> Sequence[MessageForm]:
        """What its drawings are written as."""

    def drawings(self, first: int, rows: np.ndarray, /) -> Iterable[Drawing]:
        """Of `rows` (n, width), the first of which is tick `first`; all there is at tick 0."""


class Topics:
    """Names, schemas and units are those of the recording.

    Args:
        streams, scene, tick: see `twin.robot.run.watch.Viewer.begin`.

    Attributes:
        channels: the streams in their order, those of the scene, such as `/scene`, `/tf` and `/force`, and `/events`.
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
        """Simulated time of `tick` (ns) as in the recording, which begins at 0."""
        return round(tick * (self._tick * NS_PER_S))

    def messages(
        self, tick: int, row: np.ndarray, events: Sequence[TickEvent], wanted: frozenset[int], lacking: frozenset[int]
    ) -> Iterator[Message]:
        """Of what has happened, and of the `row` of `tick`.

        Args:
            wanted: channels that anybody has subscribed to; nothing is drawn in vain.
            lacking: constant channels that are to be sent.
        """
        for event in events:
            time = self.time(event.tick)
            yield Message(self._numbers[EVENTS_TOPIC], time, log_message(time, event.level, event.text, event.source))
        time = self.time(tick)
        # sampled outputs stay valid until the next sample, so all of the row is what is valid now
        for channel, content in zip(self.channels, self._encoder.messages(row), strict=False):
            yield Message(channel.number, time, content)
        if wanted.isdisjoint(self._drawn):
            return
        # tick 0 is one at which everything is drawn
        for name, _, rows in self._scene.drawings(0, row[None, :]):
            if rows.shape[1] > 0 or self._numbers[name] in lacking:
                record = form_records(self._layouts[name], np.array([time]), 0, rows)
                yield Message(self._numbers[name], time, record[0, HEAD_SIZE:].tobytes())


class MessageEncoder:
    """The newest row of all `streams` as protobuf messages, all of them at once.

    The layout is the recording's: every number has its place in the bytes of its message (`recording/messages.py`). So
    the messages of all topics stand in one buffer, and a row is copied into it by three assignments, one for each kind
    of number, however many topics and fields there are.
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
        """The message of each stream at `row`, (width of the system's outputs,) float64."""
        for kind, columns in self._columns.items():
            self._bytes[self._places[kind]] = row[columns].astype(VALUE_TYPES[kind]).view(np.uint8)
        content = self._bytes.tobytes()
        return (content[start:end] for start, end in self._spans)
