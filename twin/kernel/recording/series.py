"""Series of numbers and events decoded from MCAP chunks."""

from collections import Counter
from dataclasses import dataclass, field
from io import BytesIO

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Message, Schema

from twin.kernel.recording.messages import (
    RECORD_PREFIX,
    Field,
    MessageLayout,
    check_stream,
    described_fields,
    message_layout,
)
from twin.kernel.recording.scan import CHANNEL, LENGTH, PLACE, SEQUENCE, Damage, Records

NANOSECONDS = 1e9
# message types for viewers, which hold no numbers that are not in the series too
FOREIGN = "foxglove."
MISSING = "a chunk before which messages are missing"


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
class TopicSeries:
    """The messages of one numeric topic as they lie in the file.

    Attributes:
        fields: from the file's schema.
        layout: of one record.
        parts: records of each chunk, (n, layout.stride) uint8.
    """

    fields: tuple[Field, ...]
    layout: MessageLayout
    parts: list[np.ndarray] = field(default_factory=list)

    def all_records(self) -> np.ndarray:
        """All records, (n, stride) uint8.

        Raises:
            ValueError: bytes between the numbers are not what the schema asks for.
        """
        records = np.concatenate([np.empty((0, self.layout.stride), np.uint8), *self.parts])
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

    series: dict[int, TopicSeries] = field(default_factory=dict)
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
        records = Records(content)
        is_message = records.table[:, CHANNEL] >= 0
        declared = self._declared(position, content, records.table[~is_message])
        messages = records.table[is_message]
        of_channel = messages[:, CHANNEL]
        number = np.bincount(of_channel)
        counts = {channel: int(number[channel]) for channel in np.flatnonzero(number).tolist()}
        parts, logs = {}, []
        for channel, count in counts.items():
            place = messages[(of_channel == channel).argmax(), PLACE] if channel in declared else 0
            if channel not in self._channels or place < declared.get(channel, 0):
                raise Damage(position, "a chunk before which the declaration of its topics is missing")
            if channel in self.series:
                part = records.of(channel, count, self.counts[channel], self.series[channel].layout.stride)
                if part is None:
                    raise Damage(position, MISSING)
                parts[channel] = part
                continue
            sequence = messages[of_channel == channel, SEQUENCE]
            if not np.array_equal(sequence, np.arange(count) + self.counts[channel]):
                raise Damage(position, MISSING)
            if channel not in self.foreign:
                logs.append(channel)
        logged = messages[np.isin(of_channel, logs)] if logs else ()
        events = [_event(_body(content, record)) for record in logged]
        for channel, part in parts.items():
            self.series[channel].parts.append(part)
        self.events += events
        self.counts.update(counts)

    def _declared(self, position: int, content: bytes, others: np.ndarray) -> dict[int, int]:
        """Declare what the chunk declares, in records that are no messages: by channel number, where in it that is.

        Raises:
            Damage: there is something else in it than declarations and messages.
        """
        declared: dict[int, int] = {}
        for record in others:
            place, opcode, length = record[: LENGTH + 1].tolist()
            if opcode not in (Opcode.SCHEMA, Opcode.CHANNEL):
                raise Damage(position, f"a chunk with a record of kind {opcode} and {length} bytes")
            stream = ReadDataStream(BytesIO(_body(content, record)))
            if opcode == Opcode.SCHEMA:
                schema = Schema.read(stream)
                self._schemas[schema.id] = schema
                continue
            channel = Channel.read(stream)
            if self._channels.setdefault(channel.id, channel) is channel:
                declared[channel.id] = place
                self._declare(channel, self._schemas[channel.schema_id])
            elif self._channels[channel.id] != channel:
                raise ValueError(f"two topics share the channel {channel.id}")
        return declared

    def _declare(self, channel: Channel, schema: Schema) -> None:
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
        self.series[channel.id] = TopicSeries(fields, message_layout(channel.id, fields))
        self.topics[channel.id] = topic


def _body(content: bytes, record: np.ndarray) -> bytes:
    """Of a record, by its row in the table of `content`."""
    place, _, length = record[: LENGTH + 1].tolist()
    return content[place + RECORD_PREFIX : place + RECORD_PREFIX + length]


def _event(body: bytes) -> Event:
    message = Message.read(ReadDataStream(BytesIO(body)), len(body))
    log = Log.FromString(message.data)
    return Event(message.log_time / NANOSECONDS, Log.Level.Name(log.level).lower(), log.message, log.name)
