"""A recording in memory: series of numbers by name."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin.kernel.errors import nearest, visible
from twin.kernel.recording.errors import UnknownSeries
from twin.kernel.recording.layout import Field
from twin.kernel.recording.messages import MessageLayout
from twin.kernel.recording.series import NANOSECONDS, Event


@dataclass(frozen=True, repr=False)
class Stream:
    """All messages of one numeric topic.

    Attributes:
        fields: in the order of the file's schema.
        layout: of one record.
        records: (n, layout.stride) uint8.
    """

    fields: tuple[Field, ...]
    layout: MessageLayout
    records: np.ndarray

    @property
    def head(self) -> np.ndarray:
        """Sequence numbers and times (ns) of the records, structured (n,)."""
        return self.records.view(self.layout.head)[:, 0]

    @property
    def values(self) -> np.ndarray:
        """Numbers of the records, structured (n,), one name per field."""
        return self.records.view(self.layout.values)[:, 0]


@dataclass(frozen=True, repr=False)
class Recording:
    """What a file holds: `recording["plant.p_B"]`, `recording.time("plant")`.

    Attributes:
        path: of the file.
        streams: numeric topics by name, without the leading slash.
        events: in the order of the file.
        metadata: name -> key -> text; records of one name are joined, later keys win.
        complete: whether the file was finished and is undamaged.
        note: one sentence that says why not and how far it was read; empty if complete.
    """

    path: Path
    streams: dict[str, Stream]
    events: list[Event]
    metadata: dict[str, dict[str, str]]
    complete: bool
    note: str

    def __getitem__(self, key: str) -> np.ndarray:
        """Values of `topic.field`: (n,) or, for a field of several values, (n, size); float64, int64 or bool.

        Raises:
            UnknownSeries: no such topic or field; it names the nearest ones.
        """
        if key not in self.fields():
            raise UnknownSeries(f"{self.path}: no series {key!r}; {nearest(key, self.fields(), 'it holds {}', 3)}", key)
        topic, _, name = key.rpartition(".")
        return np.ascontiguousarray(self.streams[topic].values[name])

    def time(self, topic: str) -> np.ndarray:
        """Simulation times of the messages of `topic`, s, (n,).

        Raises:
            UnknownSeries: no such topic; it names the nearest ones.
        """
        if topic not in self.streams:
            raise UnknownSeries(
                f"{self.path}: no topic {topic!r}; {nearest(topic, self.streams, 'it holds {}', 3)}", topic
            )
        return self.streams[topic].head["log_time"] / NANOSECONDS

    @property
    def deviations(self) -> tuple[str, ...]:
        """Sentences on what makes this run another one than that of its experiment alone; empty if nothing does."""
        said = [
            f"{name} was substituted by {kind}: the experiment alone does not make this run"
            for name, kind in self.metadata.get("substituted", {}).items()
        ]
        if "changed" in self.metadata:
            said.append("changed by hand while it ran: the experiment alone does not make this run")
        return tuple(visible(text) for text in said)

    @property
    def other_parts(self) -> tuple[str, ...]:
        """Sentences on parts of the robot that were of another make."""
        return tuple(visible(text) for text in self.metadata.get("part", {}).values())

    def fields(self) -> dict[str, Field]:
        """`topic.field` -> the field with its unit and meaning, in the order of the file."""
        return {f"{topic}.{f.name}": f for topic, stream in self.streams.items() for f in stream.fields}
