"""What a viewer can subscribe to: the topics of the recording, each at its newest row."""

from collections.abc import Sequence

import foxglove
import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log

from twin.execution.viewer import Stream
from twin.execution.watch import Event
from twin.recording.messages import HEAD_SIZE, message_layout, message_records
from twin.recording.schema import descriptor_set, log_descriptor_set, message_names
from twin.recording.writer import EVENTS, NANOSECONDS


class StreamChannel:
    """One topic on the wire: name, schema, units and bytes are those of the recording.

    Args:
        context: of the server. stream: what to publish. message_name: of its protobuf type. tick: duration (s).
    """

    def __init__(self, context: foxglove.Context, stream: Stream, message_name: str, tick: float):
        topic = stream.topic
        self._stream, self._tick = stream, tick
        self._layout = message_layout(0, topic.fields)
        self._channel = foxglove.Channel(
            f"/{topic.name}",
            schema=_schema(message_name, descriptor_set(message_name, topic.fields)),
            message_encoding="protobuf",
            context=context,
            metadata={field.name: f"{field.unit}; {field.meaning}" for field in topic.fields},
        )

    def publish(self, first: int, rows: np.ndarray) -> None:
        """Send the newest of `rows`, the first of which is tick `first`, if anybody listens and one is due."""
        period = self._stream.topic.period
        newest = len(rows) - 1 - (first + len(rows) - 1) % period
        if newest < 0 or not self._channel.has_sinks():
            return
        row = rows[newest : newest + 1, self._stream.columns]
        record = message_records(self._layout, self._stream.topic.fields, np.zeros(1, dtype=np.int64), 0, row)
        self._channel.log(record[0, HEAD_SIZE:].tobytes(), log_time=nanoseconds(first + newest, self._tick))

    def close(self) -> None:
        """Take it off the list of topics."""
        self._channel.close()


class EventChannel:
    """`/events`: every event, at the tick at which it happened.

    Args:
        context: of the server. tick: duration (s).
    """

    def __init__(self, context: foxglove.Context, tick: float):
        self._tick = tick
        schema = _schema(Log.DESCRIPTOR.full_name, log_descriptor_set())
        self._channel = foxglove.Channel(f"/{EVENTS}", schema=schema, message_encoding="protobuf", context=context)

    def publish(self, events: Sequence[Event]) -> None:
        """Send all of them, if anybody listens."""
        if not self._channel.has_sinks():
            return
        for event in events:
            time = nanoseconds(event.tick, self._tick)
            log = Log(level=Log.Level.Value(event.level), message=event.text, name=event.source)
            log.timestamp.FromNanoseconds(time)
            self._channel.log(log.SerializeToString(), log_time=time)

    def close(self) -> None:
        """Take it off the list of topics."""
        self._channel.close()


def channels(context: foxglove.Context, streams: Sequence[Stream], tick: float) -> list[StreamChannel]:
    """A channel for each of `streams`, with the message types that the recording gives them."""
    names = message_names([stream.topic for stream in streams])
    return [StreamChannel(context, stream, name, tick) for stream, name in zip(streams, names, strict=True)]


def nanoseconds(tick_number: int, tick: float) -> int:
    """Simulation time of a tick as in the recording, which begins at 0 (ns)."""
    return round(tick_number * (tick * NANOSECONDS))


def _schema(name: str, descriptors: bytes) -> foxglove.Schema:
    return foxglove.Schema(name=name, encoding="protobuf", data=descriptors)
