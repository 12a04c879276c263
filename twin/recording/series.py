"""Chunks taken apart into the series of numbers and the events they hold."""

import struct
from collections import Counter
from dataclasses import dataclass, field
from io import BytesIO

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema

from twin.recording.layout import Field, check_stream
from twin.recording.messages import HEAD_SIZE, RECORD_PREFIX, MessageLayout, message_layout
from twin.recording.scan import Damage
from twin.recording.schema import described_fields
from twin.recording.weave import record_windows

NANOSECONDS = 1e9
# message types for viewers, which hold no numbers that are not in the series too
FOREIGN = "foxglove."
MISSING = "a chunk before which messages are missing"
# in the body of a Message record, behind the channel
SEQUENCE, SEQUENCE_OFFSET = struct.Struct("<I"), 2
# channel, sequence number and two times: no message is shorter
MESSAGE_FRONT = HEAD_SIZE - RECORD_PREFIX
# opcode, length and, in messages, channel: the front of every record in a chunk
FRONT = struct.Struct("<BQH")


@dataclass(frozen=True)
class Event:
    """Something that happened.

    Attributes:
        time: simulation time, s.
        level: `debug`, `info`, `warning`, `error` or `fatal`.
        text: one sentence.
        name: the component it happened in.
    """

    time: float
    level: str
    text: str
    name: str


@dataclass
class Series:
    """The messages of one numeric topic as they lie in the file.

    Attributes:
        fields: from the file's schema.
        layout: of one record.
        parts: records of each chunk, (n,) opaque items of layout.stride bytes.
    """

    fields: tuple[Field, ...]
    layout: MessageLayout
    parts: list[np.ndarray] = field(default_factory=list)

    def records_at(self, content: np.ndarray, offsets: np.ndarray) -> np.ndarray:
        """Records (n,) at `offsets` (n,) of a chunk's content (bytes,) uint8.

        Raises:
            ValueError: they have another length than the layout.
        """
        lengths = record_windows(content, 8)[offsets + 1].view("<u8")
        if np.any(lengths != self.layout.stride - RECORD_PREFIX):
            raise ValueError("messages whose length is not that of their schema")
        return record_windows(content, self.layout.stride)[offsets]

    def begins_at(self, sequence: int, records: np.ndarray) -> bool:
        """Whether the sequence numbers of `records` (n,) count from `sequence` on."""
        expected = np.arange(sequence, sequence + len(records))
        return np.array_equal(records.view(self.layout.head)["sequence"], expected)

    def all_records(self) -> np.ndarray:
        """All records, (n, stride) uint8.

        Raises:
            ValueError: bytes between the numbers are not what the schema asks for.
        """
        stride = self.layout.stride
        records = np.concatenate([np.empty(0, f"V{stride}"), *self.parts]).view(np.uint8).reshape(-1, stride)
        for part in self.layout.framing:
            if np.any(records[:, part] != self.layout.filling.template[part]):
                raise ValueError("messages whose bytes are not those of their schema")
        return records


@dataclass
class Contents:
    """Everything found in a recording's chunks so far.

    Attributes:
        series: numeric topics by channel number.
        topics: their names, without the leading slash, by channel number.
        events: in the order of the file.
        foreign: channel numbers of topics for viewers, whose messages are passed over.
        counts: messages so far by channel number, which is the sequence number expected next.
    """

    series: dict[int, Series] = field(default_factory=dict)
    topics: dict[int, str] = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    foreign: set[int] = field(default_factory=set)
    counts: Counter[int] = field(default_factory=Counter)
    _schemas: dict[int, Schema] = field(default_factory=dict)
    _channels: dict[int, Channel] = field(default_factory=dict)

    def add(self, position: int, content: bytes) -> None:
        """Add all messages of the chunk at `position` in the file, or none.

        Raises:
            Damage: messages that precede the chunk's are not there.
            ValueError, KeyError, struct.error, McapError, DecodeError: not what twin writes.
        """
        offsets: dict[int, list[int]] = {}
        events, counts, place = [], self.counts.copy(), 0
        while place < len(content):
            opcode, length, channel = FRONT.unpack_from(content, place)
            body = content[place + RECORD_PREFIX : place + RECORD_PREFIX + length]
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._declare(opcode, body)
            elif opcode != Opcode.MESSAGE or length < MESSAGE_FRONT:
                raise Damage(position, f"a chunk with a record of kind {opcode} and {length} bytes")
            elif channel not in self._channels:
                raise Damage(position, "a chunk before which the declaration of its topics is missing")
            else:
                if channel in self.series:
                    offsets.setdefault(channel, []).append(place)
                elif channel not in self.foreign:
                    events.append(_event(body))
                elif SEQUENCE.unpack_from(body, SEQUENCE_OFFSET)[0] != counts[channel]:
                    raise Damage(position, MISSING)
                counts[channel] += 1
            place += RECORD_PREFIX + length
        array = np.frombuffer(content, dtype=np.uint8)
        parts = {c: self.series[c].records_at(array, np.array(own)) for c, own in offsets.items()}
        if not all(self.series[c].begins_at(self.counts[c], records) for c, records in parts.items()):
            raise Damage(position, MISSING)
        for channel, records in parts.items():
            self.series[channel].parts.append(records)
        self.events += events
        self.counts = counts

    def _declare(self, opcode: int, body: bytes) -> None:
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self._schemas[schema.id] = schema
            return
        channel = Channel.read(stream)
        if channel.id in self._channels:
            if self._channels[channel.id] != channel:
                raise ValueError(f"two topics share the channel {channel.id}")
            return
        self._channels[channel.id] = channel
        schema = self._schemas[channel.schema_id]
        if schema.name == Log.DESCRIPTOR.full_name:
            return
        if schema.name.startswith(FOREIGN):
            self.foreign.add(channel.id)
            return
        fields = described_fields(schema.name, schema.data)
        topic = channel.topic.removeprefix("/")
        check_stream(topic, 1)
        if topic in self.topics.values():
            raise ValueError(f"two channels of the topic {topic}")
        self.series[channel.id] = Series(fields, message_layout(channel.id, fields))
        self.topics[channel.id] = topic


def _event(body: bytes) -> Event:
    message = Message.read(ReadDataStream(BytesIO(body)), len(body))
    log = Log.FromString(message.data)
    return Event(message.log_time / NANOSECONDS, Log.Level.Name(log.level).lower(), log.message, log.name)
