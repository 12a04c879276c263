"""What components are called in a recording, in a viewer and in memory."""

import re
from dataclasses import dataclass

from twin.cosim.system import System
from twin.recording.layout import Field, Topic


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
