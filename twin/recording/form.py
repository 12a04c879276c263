"""Messages of any protobuf type as a filled-in form: an example, with blanks where numbers and times go.

A viewer's types nest messages whose lengths depend on what is in them. Protobuf leaves that to the writer: a zero may
be written out, and an integer may take more bytes than it needs (its conformance tests ask every reader to take
both). So all messages of a form can have one length, and like those of `messages.py` a series of them is one record
repeated, with columns of numbers put into it.
"""

import struct
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp

from twin.recording.filling import DOUBLE, GROUPS, NANOS, SECONDS, Filling
from twin.recording.layout import check_stream
from twin.recording.messages import HEAD_SIZE, record_template

# seconds and nanoseconds as integers of five groups of 7 bits, `filling.GROUPS`; both of these need all five
BLANK_TIME = Timestamp(seconds=2**34, nanos=2**29)
"""Stands in an example where the message's own time goes."""
TIME_BYTES = BLANK_TIME.SerializeToString(deterministic=True)
# behind their tags of one byte each
SECONDS_AT, NANOS_AT = 1, 1 + GROUPS + 1
# the upper half of a double of about 1e307 that nobody writes in earnest; the lower half is the column
BLANK = 0x7FC0_7749


def blank(column: int) -> float:
    """Stands in an example where the numbers of `column` of the rows go."""
    return struct.unpack("<d", struct.pack("<II", column, BLANK))[0]


@dataclass(frozen=True)
class Form:
    """A stream of messages that differ only in times and numbers.

    Attributes:
        name: without the leading slash that it has in the file: `tf`.
        example: with `blank(0)`, `blank(1)`, ... in fields of type double, each somewhere, and `BLANK_TIME`.
        width: number of columns of the rows handed to `Writer.write`.
        period: ticks from one message to the next.

    Raises:
        ValueError: a name or period that no stream can have.
    """

    name: str
    example: Message
    width: int
    period: int

    def __post_init__(self) -> None:
        check_stream(self.name, self.period)


def form_filling(channel: int, form: Form) -> Filling:
    """Filling of the Message records of channel number `channel`.

    Raises:
        ValueError: a column has no blank in the example.
    """
    body = form.example.SerializeToString(deterministic=True)
    doubles = [struct.pack("<d", blank(column)) for column in range(form.width)]
    found = [(column, place) for column, double in enumerate(doubles) for place in _places(body, double)]
    missing = set(range(form.width)) - {column for column, _ in found}
    if missing:
        raise ValueError(f"form {form.name}: columns {sorted(missing)} have no blank in the example")
    places = [(DOUBLE, column, place) for column, place in found]
    for place in _places(body, TIME_BYTES):
        places += [(SECONDS, 0, place + SECONDS_AT), (NANOS, 0, place + NANOS_AT)]
    table = np.array(places, dtype=np.int64).reshape(-1, 3) + np.array([0, 0, HEAD_SIZE])
    return Filling(record_template(channel, body), table)


def form_records(filling: Filling, times: np.ndarray, first_sequence: int, rows: np.ndarray) -> np.ndarray:
    """Message records of `rows`, (n, stride) uint8.

    Args:
        times: of the messages, ns, (n,) integer, from 0 to 2^34 s.
        rows: (n, width) float64.
    """
    records = filling.records(times, first_sequence, rows)
    assert records is not None, "there are no integers"
    return records


def _places(body: bytes, wanted: bytes) -> Iterator[int]:
    """Offsets of `wanted` in `body`, ascending."""
    place = body.find(wanted)
    while place >= 0:
        yield place
        place = body.find(wanted, place + len(wanted))
