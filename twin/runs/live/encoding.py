"""The newest row of all topics as protobuf messages, all of them at once.

The layout is the recording's: every number has its place in the bytes of its message (`recording/messages.py`). So the
messages of all topics stand in one buffer, and a row is copied into it by three assignments, one for each kind of
number, however many topics and fields there are.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from twin.recording.layout import Kind
from twin.recording.messages import HEAD_SIZE, VALUE_TYPES, message_layout
from twin.runs.streams import Stream


class Encoder:
    """Encodes rows of `streams`."""

    def __init__(self, streams: Sequence[Stream]):
        messages, columns, places = [], _by_kind(), _by_kind()
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
            messages.append(layout.template[HEAD_SIZE:])
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


def _by_kind() -> dict[Kind, list[int]]:
    return {kind: [] for kind in VALUE_TYPES}
