"""What a viewer can subscribe to: the topics of the recording."""

from collections.abc import Iterator, Sequence

import foxglove
import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log

from twin.execution.watch import Event
from twin.recording.form import Form, form_layout, form_records
from twin.recording.layout import Topic
from twin.recording.messages import HEAD_SIZE
from twin.recording.schema import descriptor_set, descriptors_of, log_descriptor_set, message_names
from twin.recording.writer import EVENTS, NANOSECONDS
from twin.scene.scene import Scene


def stream_channels(context: foxglove.Context, topics: Sequence[Topic]) -> list[foxglove.Channel]:
    """A channel for each of `topics`: names, schemas and units are those of the recording."""
    return [
        _channel(
            context,
            topic.name,
            name,
            descriptor_set(name, topic.fields),
            {field.name: f"{field.unit}; {field.meaning}" for field in topic.fields},
        )
        for topic, name in zip(topics, message_names(topics), strict=True)
    ]


class FormChannel:
    """A topic for 3-D viewers; what it draws is a row of the numbers that its form leaves blank."""

    def __init__(self, context: foxglove.Context, form: Form):
        descriptor = form.example.DESCRIPTOR
        self.channel = _channel(context, form.name, descriptor.full_name, descriptors_of(descriptor), {})
        self._layout = form_layout(0, form)

    def publish(self, time: int, rows: np.ndarray) -> None:
        """Send what the form looks like with `rows`, (1, width), at simulated `time` (ns)."""
        record = form_records(self._layout, np.array([time]), 0, rows)
        self.channel.log(record[0, HEAD_SIZE:].tobytes(), log_time=time)


class SceneChannels:
    """The robot, for 3-D viewers: `/scene`, `/tf` and `/force`, drawn only if somebody looks."""

    def __init__(self, context: foxglove.Context, scene: Scene):
        self._scene = scene
        self._forms = {form.name: FormChannel(context, form) for form in scene.forms}

    def __iter__(self) -> Iterator[foxglove.Channel]:
        return (form.channel for form in self._forms.values())

    def publish(self, time: int, row: np.ndarray, still: bool) -> None:
        """Send what is to be seen of `row` at simulated `time` (ns); `still`: also what never changes."""
        if not any(channel.has_sinks() for channel in self):
            return
        # tick 0 is one at which everything is drawn
        for name, _, rows in self._scene.drawings(0, row[None, :]):
            if still or rows.shape[1] > 0:
                self._forms[name].publish(time, rows)


class EventChannel:
    """`/events`, each at the tick at which it happened."""

    def __init__(self, context: foxglove.Context):
        self.channel = _channel(context, EVENTS, Log.DESCRIPTOR.full_name, log_descriptor_set(), {})

    def publish(self, time: int, event: Event) -> None:
        """Send it, at simulated `time` (ns)."""
        log = Log(level=Log.Level.Value(event.level), message=event.text, name=event.source)
        log.timestamp.FromNanoseconds(time)
        self.channel.log(log.SerializeToString(), log_time=time)


def nanoseconds(tick_number: int, tick: float) -> int:
    """Simulation time of a tick as in the recording, which begins at 0 (ns)."""
    return round(tick_number * (tick * NANOSECONDS))


def _channel(
    context: foxglove.Context, name: str, type_name: str, descriptors: bytes, metadata: dict[str, str]
) -> foxglove.Channel:
    schema = foxglove.Schema(name=type_name, encoding="protobuf", data=descriptors)
    return foxglove.Channel(f"/{name}", schema=schema, message_encoding="protobuf", context=context, metadata=metadata)
