"""Messages for viewers are those of the recording."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from twin.kernel.recording.layout import Field, Topic
from twin.kernel.recording.messages import HEAD_SIZE, message_layout, message_records
from twin.kernel.recording.recorder import RowStream
from twin.robot.live.topics import Encoder

TOPICS = (
    Topic("a", (Field("x", 3, "double", "m", ""), Field("n", 2, "int", "1", ""), Field("on", 1, "bool", "1", "")), 1),
    Topic(
        "b/1", (Field("on", 2, "bool", "1", ""), Field("J", 20, "double", "m", ""), Field("n", 1, "int", "1", "")), 2
    ),
)
STREAMS = (RowStream(TOPICS[0], slice(0, 6)), RowStream(TOPICS[1], slice(6, 29)))
WHOLE = (3, 4, 28)
"""Columns that hold whole numbers."""


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False, width=32), min_size=29, max_size=29))
def test_a_published_message_has_the_bytes_of_the_recorded_one(numbers: list[float]):
    row = np.array(numbers)
    row[list(WHOLE)] = np.clip(np.rint(row[list(WHOLE)]), -(2.0**62), 2.0**62)
    encoder = Encoder(STREAMS)
    # twice, because what was there before must not shine through
    list(encoder.messages(np.ones(29)))
    for stream, message in zip(STREAMS, encoder.messages(row), strict=True):
        fields = stream.topic.fields
        records = message_records(
            message_layout(7, fields), fields, np.zeros(1, dtype=int), 0, row[None, stream.columns]
        )
        assert message == records[0, HEAD_SIZE:].tobytes()
