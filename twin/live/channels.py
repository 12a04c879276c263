"""What a viewer can subscribe to: the topics of the recording."""

from collections.abc import Sequence

import foxglove
from foxglove_schemas_protobuf.Log_pb2 import Log

from twin.execution.watch import Event
from twin.recording.layout import Topic
from twin.recording.schema import descriptor_set, log_descriptor_set, message_names
from twin.recording.writer import EVENTS, NANOSECONDS


class StreamChannel:
    """One topic on the wire: name, schema, units and bytes are those of the recording.

    Args:
        context: of the server. topic: what to announce. message_name: of its protobuf type. tick: duration (s).
    """

    def __init__(self, context: foxglove.Context, topic: Topic, message_name: str, tick: float):
        self._period, self._tick = topic.period, tick
        self._channel = foxglove.Channel(
            f"/{topic.name}",
            schema=_schema(message_name, descriptor_set(message_name, topic.fields)),
            message_encoding="protobuf",
            context=context,
            metadata={field.name: f"{field.unit}; {field.meaning}" for field in topic.fields},
        )

    def publish(self, first: int, last: int, message: bytes) -> None:
        """Send what is valid at tick `last`, at the time of its sample, unless that was taken before tick `first`."""
        sample = last - last % self._period
        if sample >= first:
            self._channel.log(message, log_time=nanoseconds(sample, self._tick))

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

    def publish(self, event: Event) -> None:
        """Send it."""
        time = nanoseconds(event.tick, self._tick)
        log = Log(level=Log.Level.Value(event.level), message=event.text, name=event.source)
        log.timestamp.FromNanoseconds(time)
        self._channel.log(log.SerializeToString(), log_time=time)

    def close(self) -> None:
        """Take it off the list of topics."""
        self._channel.close()


def channels(context: foxglove.Context, topics: Sequence[Topic], tick: float) -> list[StreamChannel]:
    """A channel for each of `topics`, with the message types that the recording gives them."""
    return [
        StreamChannel(context, topic, name, tick) for topic, name in zip(topics, message_names(topics), strict=True)
    ]


def nanoseconds(tick_number: int, tick: float) -> int:
    """Simulation time of a tick as in the recording, which begins at 0 (ns)."""
    return round(tick_number * (tick * NANOSECONDS))


def _schema(name: str, descriptors: bytes) -> foxglove.Schema:
    return foxglove.Schema(name=name, encoding="protobuf", data=descriptors)
