"""Whole series of protobuf messages at once, as numpy records of one stride.

Every field has a fixed length on the wire (https://protobuf.dev/programming-guides/encoding: double and
sfixed64 are 8 bytes, bool is 1 as it is 0 or 1) and is written even where it is zero. So the messages of a
topic have one length, and the MCAP Message records (https://mcap.dev/spec#message-op0x05) around them too. A
series is then a template repeated n times with columns of numbers put into it; no message is encoded or decoded on
its own.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from mcap.opcode import Opcode

from twin.recording.filling import BOOL, DOUBLE, INTEGER, LOG_TIME_AT, PUBLISH_TIME_AT, SEQUENCE_AT, Filling
from twin.recording.layout import Field, Kind

# the fixed front of an MCAP Message record, little endian and unpadded
HEAD_NAMES = ["opcode", "length", "channel", "sequence", "log_time", "publish_time"]
HEAD_FORMATS = [np.dtype(code) for code in ("u1", "<u8", "<u2", "<u4", "<u8", "<u8")]
HEAD_OFFSETS = [0, 1, 9, SEQUENCE_AT, LOG_TIME_AT, PUBLISH_TIME_AT]
HEAD_SIZE = 31
# opcode, length and channel; sequence and times differ from message to message
CONSTANT_HEAD = slice(0, 11)
# opcode and length are not counted in the length of a record
RECORD_PREFIX = 9
VALUE_TYPES: dict[Kind, np.dtype] = {"double": np.dtype("<f8"), "int": np.dtype("<i8"), "bool": np.dtype("?")}
PLACE_KINDS: dict[Kind, int] = {"double": DOUBLE, "int": INTEGER, "bool": BOOL}
# wire types of protobuf
VARINT, I64, LEN = 0, 1, 2


@dataclass(frozen=True)
class MessageLayout:
    """Where the bytes of one topic's Message records are.

    Attributes:
        filling: of a record with every number zero: tags, lengths and channel only.
        framing: slices of the record that hold no number and are equal in every message of the topic.
        head: structured dtype of the record's front, itemsize = stride.
        values: structured dtype of the record's numbers, one name per field, itemsize = stride.
    """

    filling: Filling
    framing: tuple[slice, ...]
    head: np.dtype
    values: np.dtype

    @property
    def stride(self) -> int:
        """Bytes from one record to the next."""
        return self.values.itemsize


def message_layout(channel: int, fields: Sequence[Field]) -> MessageLayout:
    """Layout of the Message records of channel number `channel` with `fields` numbered from 1."""
    record = bytearray(HEAD_SIZE)
    framing = [CONSTANT_HEAD]
    formats: list[np.dtype] = []
    offsets: list[int] = []
    for number, field in enumerate(fields, start=1):
        value_type = VALUE_TYPES[field.kind]
        if field.size > 1:
            tag = varint(number << 3 | LEN) + varint(field.size * value_type.itemsize)
        else:
            tag = varint(number << 3 | (VARINT if field.kind == "bool" else I64))
        framing.append(slice(len(record), len(record) + len(tag)))
        record += tag
        offsets.append(len(record))
        formats.append(np.dtype((value_type, (field.size,))) if field.size > 1 else value_type)
        record += bytes(field.size * value_type.itemsize)
    names = [field.name for field in fields]
    values = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": len(record)})
    elements = [
        (PLACE_KINDS[field.kind], offset + n * value_type.base.itemsize)
        for field, value_type, offset in zip(fields, formats, offsets, strict=True)
        for n in range(field.size)
    ]
    places = np.array([(kind, column, offset) for column, (kind, offset) in enumerate(elements)], dtype=np.int64)
    filling = Filling(record_template(channel, bytes(record[HEAD_SIZE:])), places)
    return MessageLayout(filling, tuple(framing), head_dtype(len(record)), values)


def head_dtype(stride: int) -> np.dtype:
    """Structured dtype of the front of a Message record of `stride` bytes."""
    return np.dtype({"names": HEAD_NAMES, "formats": HEAD_FORMATS, "offsets": HEAD_OFFSETS, "itemsize": stride})


def record_template(channel: int, body: bytes) -> np.ndarray:
    """Message record of `body` on channel number `channel`, (stride,) uint8, with no sequence number or time yet."""
    template = np.frombuffer(bytearray(HEAD_SIZE) + body, dtype=np.uint8)
    front = template.view(head_dtype(len(template)))
    front["opcode"], front["length"], front["channel"] = Opcode.MESSAGE, len(template) - RECORD_PREFIX, channel
    return template


def message_records(
    layout: MessageLayout, fields: Sequence[Field], times: np.ndarray, first_sequence: int, rows: np.ndarray
) -> np.ndarray:
    """Message records of `rows`, (n, stride) uint8.

    Args:
        fields: of the topic, in the order of the columns.
        times: log and publish times, ns, (n,) integer.
        rows: (n, sum of sizes) float64; a bool is what is not zero.

    Raises:
        ValueError: an `int` field holds something other than whole numbers (nan included).
    """
    records = layout.filling.records(times, first_sequence, rows)
    if records is None:
        raise ValueError(no_integer(fields, rows))
    return records


def no_integer(fields: Sequence[Field], rows: np.ndarray) -> str:
    """A sentence about the first of `rows` that has none where `fields` want one."""
    start = 0
    for field in fields:
        values = rows[:, start : start + field.size]
        # one beyond 2^63 is whole, but no integer
        wrong = values[~((values == np.floor(values)) & (values >= -(2.0**63)) & (values < 2.0**63))]
        if field.kind == "int" and wrong.size:
            return f"field {field.name} holds whole numbers, got {wrong[0]}"
        start += field.size
    raise AssertionError("every integer is one")


def varint(number: int) -> bytes:
    """`number` as protobuf's base-128 variable-length integer, least significant group first."""
    groups = []
    while number > 0x7F:
        groups.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*groups, number])
