"""The live server: Foxglove's WebSocket protocol on this machine's own address."""

import socket
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from typing import Self

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log

from twin.kernel.cosim.observers import TickEvent
from twin.kernel.errors import InputRefused
from twin.kernel.live import Channel, Gate, Message
from twin.kernel.recording.messages import (
    HEAD_SIZE,
    VALUE_TYPES,
    Kind,
    descriptor_set,
    descriptors_of,
    form_filling,
    form_records,
    log_descriptor_set,
    message_layout,
    message_names,
)
from twin.kernel.recording.recorder import RowStream
from twin.kernel.recording.writer import EVENTS, NANOSECONDS
from twin.robot.live.broadcast import HOST, Broadcast
from twin.robot.run.watch import Tuning
from twin.robot.scene import Scene


class Topics:
    """Names, schemas and units are those of the recording.

    Args:
        streams, scene, tick: see `twin.robot.run.viewer.Viewer.begin`.

    Attributes:
        channels: the streams in their order, `/scene`, `/tf` and `/force`, which draw the robot, and `/events`.
    """

    def __init__(self, streams: Sequence[RowStream], scene: Scene, tick: float):
        self._encoder, self._scene, self._tick = MessageEncoder(streams), scene, tick
        self._layouts = {form.name: form_filling(0, form) for form in scene.forms}
        events: _Channel = (EVENTS, Log.DESCRIPTOR.full_name, log_descriptor_set(), {}, False)
        channels = [*_streams(streams), *_forms(scene), events]
        self.channels = tuple(
            Channel(number, f"/{name}", kind, descriptors, meanings, constant)
            for number, (name, kind, descriptors, meanings, constant) in enumerate(channels, start=1)
        )
        self._numbers = {channel.topic[1:]: channel.number for channel in self.channels}
        self._drawn = {self._numbers[name] for name in self._layouts}

    def time(self, tick: int) -> int:
        """Simulated time of `tick` (ns) as in the recording, which begins at 0."""
        return round(tick * (self._tick * NANOSECONDS))

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
            yield Message(self._numbers[EVENTS], time, _log(event, time))
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


_Channel = tuple[str, str, bytes, dict[str, str], bool]


def _streams(streams: Sequence[RowStream]) -> Iterator[_Channel]:
    topics = [stream.topic for stream in streams]
    for topic, name in zip(topics, message_names(topics), strict=True):
        units = {field.name: f"{field.unit}; {field.meaning}" for field in topic.fields}
        yield topic.name, name, descriptor_set(name, topic.fields), units, False


def _forms(scene: Scene) -> Iterator[_Channel]:
    for form in scene.forms:
        descriptor = form.example.DESCRIPTOR
        yield form.name, descriptor.full_name, descriptors_of(descriptor), {}, form.width == 0


def _log(event: TickEvent, time: int) -> bytes:
    log = Log(level=Log.Level.Value(event.level), message=event.text, name=event.source)
    log.timestamp.FromNanoseconds(time)
    return log.SerializeToString()


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


SPACING = 0.02
"""Wall time (s) from one message of a topic to the next: 50 Hz, below the 60 Hz above which Lichtblick warns."""


class LiveServer:
    """A `twin.robot.run.viewer.Viewer`; a context manager at whose exit what was published has been sent.

    Each run is a broadcast of its own at the same port, with the same token. Viewers come back by themselves, and
    before the first run the port is held by a socket that does not listen.

    Args:
        port: to listen at; 0: any that is free.
        announce: called with the address, `ws://127.0.0.1:8765/?token=...`, whenever a run waits for its first viewer.
        warn: called with a sentence about connections that are refused meanwhile.
        origins: see `Gate`.

    Raises:
        InputRefused: the port is taken, or one of `origins` is none.
    """

    def __init__(
        self,
        port: int,
        announce: Callable[[str], None],
        warn: Callable[[str], None] = lambda text: None,
        origins: Sequence[str] = (),
    ):
        self._announce, self._warn, self._gate = announce, warn, Gate(origins)
        self._held = socket.socket()
        try:
            self._held.bind((HOST, port))
        except OSError as problem:
            self._held.close()
            raise _refusal(port, problem) from None
        self._port = self._held.getsockname()[1]
        self._on_air: tuple[Broadcast, Publisher | None] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *failure: object) -> None:
        self._held.close()
        self._sign_off()

    def begin(self, streams: Sequence[RowStream], scene: Scene, tick: float, tuning: Tuning) -> None:
        """Wait until somebody has subscribed to one of the topics.

        Raises:
            InputRefused: somebody has taken the port in the meantime.
        """
        self._held.close()
        self._sign_off()
        topics = Topics(streams, scene, tick)
        try:
            broadcast = Broadcast(self._port, self._gate, topics.channels, tuning)
        except OSError as problem:
            raise _refusal(self._port, problem) from None
        self._on_air = broadcast, None
        self._announce(f"ws://{HOST}:{self._port}/?token={self._gate.token}")
        for refusal in iter(broadcast.news.get, None):
            self._warn(refusal)
        self._on_air = broadcast, Publisher(topics, broadcast)

    def show(self, first: int, rows: np.ndarray, events: Sequence[TickEvent]) -> None:
        """Hand the first row of the run, the newest one and every event to the publisher."""
        if self._on_air and self._on_air[1] and len(rows):
            self._on_air[1].put(first, rows, events)

    def _sign_off(self) -> None:
        if self._on_air:
            broadcast, publisher = self._on_air
            if publisher:
                publisher.finish()
            broadcast.close()
            self._on_air = None


def _refusal(port: int, problem: Exception) -> InputRefused:
    return InputRefused(f"--port {port}: {problem}; choose another one, or 0 for any that is free")


class Publisher:
    """Publishes the rows of one run while it goes on; begins at once.

    The thread that steps only leaves its newest row here; a thread of this class takes it away from time to time,
    whatever the pace of the run. Making the messages in the thread that steps would cost that one much more, and more
    often. The first row of all is published however fast the run goes on: viewers for whom it waited see its beginning.

    Args:
        topics: of the run.
        broadcast: takes their messages.
    """

    def __init__(self, topics: Topics, broadcast: Broadcast):
        self._topics, self._broadcast = topics, broadcast
        self._happened: deque[TickEvent] = deque()
        self._first: tuple[int, np.ndarray] | None = None
        self._newest: tuple[int, np.ndarray] | None = None
        self._published = -1
        self._finished = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def put(self, first: int, rows: np.ndarray, events: Sequence[TickEvent]) -> None:
        """What has happened, and `rows` from tick `first` on. Of them the last one counts, until the next call."""
        if events:
            self._happened.extend(events)
        if self._first is None:
            self._first = (first, rows[0].copy())
        # one assignment, so the other thread sees either the old pair or the new one
        self._newest = (first + len(rows) - 1, rows[-1].copy())

    def finish(self) -> None:
        """Publish the last row and stop."""
        self._finished.set()
        self._thread.join()

    def _work(self) -> None:
        while not self._finished.wait(SPACING):
            self._publish()
        self._publish()

    def _publish(self) -> None:
        newest = self._newest
        if newest is None:
            return
        if self._first is not None and self._published < 0:
            self._send(*self._first, [])
        if newest[0] > self._published:
            self._send(*newest, [self._happened.popleft() for _ in range(len(self._happened))])

    def _send(self, tick: int, row: np.ndarray, events: Sequence[TickEvent]) -> None:
        messages = self._topics.messages(tick, row, events, self._broadcast.wanted, self._broadcast.lacking)
        self._broadcast.publish(self._topics.time(tick), list(messages))
        self._published = tick
