"""Encoding and decoding of series of protobuf messages as MCAP Message records of one length.

Every field has a fixed length on the wire (https://protobuf.dev/programming-guides/encoding: double and sfixed64 are 8
bytes, bool is 1 as it is 0 or 1) and is written even where it is zero. So all Message records of a topic
(https://mcap.dev/spec#message-op0x05) have one length (stride), and a series is a template repeated n times into which
compiled code copies times and numbers; no message is encoded or decoded individually.

A table of places, (k, 3) int64, states where the numbers of a row go: kind, column of the rows, offset in the record.
Times are stored as seconds and nanoseconds.

`MessageForm` does the same for any other protobuf type, such as the viewers': an example message with blanks for
numbers and times. Protobuf lets the writer write out a zero and use more bytes for an integer than needed (its
conformance tests ask every reader to accept both), so all messages of a form have one length too.
"""

import re
import struct
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.descriptor import Descriptor, FileDescriptor
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet
from google.protobuf.message import Message
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.opcode import Opcode

from twin.kernel.compiled.function import carray, copy, store_number
from twin.kernel.compiled.native import address_of, entry

Kind = Literal["double", "int", "bool"]

# field names become protobuf identifiers; topic names become `/name` with slashes inside
FIELD_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
TOPIC_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z0-9_]+)*")
PROTO_PACKAGE = "twin"
# sfixed64 rather than int64: every count takes 8 bytes, so messages have one length
PROTOBUF_TYPES: dict[Kind, FieldDescriptorProto.Type.ValueType] = {
    "double": FieldDescriptorProto.TYPE_DOUBLE,
    "int": FieldDescriptorProto.TYPE_SFIXED64,
    "bool": FieldDescriptorProto.TYPE_BOOL,
}
FIELD_KINDS: dict[int, Kind] = {number: kind for kind, number in PROTOBUF_TYPES.items()}
CONTROL_CHARACTERS = re.compile(r"[\x00-\x1f\x7f-\x9f]")
"""Control characters, which a terminal may obey."""
MAX_FIELD_SIZE = 10_000
"""Maximum number of values of a field; it limits the memory that a schema can demand."""
# field numbers of `message_type` in FileDescriptorProto and of `field` in DescriptorProto, for source paths
MESSAGE_TYPE_NUMBER, FIELD_NUMBER = 4, 2
DOUBLE_PLACE, INTEGER_PLACE, BOOL_PLACE, SECONDS_PLACE, NANOS_PLACE = range(5)
"""Kinds of places: a double, a 64-bit integer, a byte that is 0 or 1, and a time in groups of 7 bits."""
SEQUENCE_AT, LOG_TIME_AT, PUBLISH_TIME_AT = 11, 15, 23
"""Offsets of the varying fields in an MCAP Message record (https://mcap.dev/spec#message-op0x05)."""
TIME_GROUPS = 5
"""Number of 7-bit groups of the varints that store seconds and nanoseconds in a form."""
NS_PER_S = 10**9
FLOAT_TYPE = np.dtype(np.float64)
FLOAT_BYTES = FLOAT_TYPE.itemsize
NO_PLACES = np.empty((0, 3), dtype=np.int64)
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
PLACE_KINDS: dict[Kind, int] = {"double": DOUBLE_PLACE, "int": INTEGER_PLACE, "bool": BOOL_PLACE}
# wire types of protobuf
VARINT, I64, LEN = 0, 1, 2
# seconds and nanoseconds as integers of `TIME_GROUPS` groups of 7 bits; both of these values need all five
BLANK_TIME = Timestamp(seconds=2**34, nanos=2**29)
"""Placeholder of the message's own time in an example message."""
TIME_BYTES = BLANK_TIME.SerializeToString(deterministic=True)
# offsets in the encoded time, after a tag of one byte each
SECONDS_AT, NANOS_AT = 1, 1 + TIME_GROUPS + 1
# the upper half of a double of about 1e307, an implausible value; the lower half is the column
BLANK_BITS = 0x7FC0_7749


@dataclass(frozen=True)
class Field:
    """A recorded quantity of a topic, of `size` values in every message (1 for a scalar).

    The name is a letter, then letters, digits or _: `tip_speed`. `int` has 64 bits, for counts. The unit is SI, `1` for
    pure numbers, the meaning a sentence for readers of the file, with frame and sign. ValueError: invalid name or size.
    """

    name: str
    size: int
    kind: Kind
    unit: str
    meaning: str

    def __post_init__(self) -> None:
        if not FIELD_NAME.fullmatch(self.name):
            raise ValueError(f"field name {self.name!r}: expected a letter, then letters, digits or _")
        if self.size < 1:
            raise ValueError(f"field {self.name}: size is {self.size}, expected 1 or more")
        if self.kind not in get_args(Kind):
            raise ValueError(f"field {self.name}: kind is {self.kind!r}, expected one of {get_args(Kind)}")


@dataclass(frozen=True)
class Topic:
    """A recorded stream of messages of one type, one every `period` ticks.

    The name, `plant`, `drive/1`, lacks the leading slash that it has in the file; fields have the order of the columns
    of rows passed to `Writer.write`. ValueError: invalid name or period, no fields, or two of one name.
    """

    name: str
    fields: tuple[Field, ...]
    period: int

    def __post_init__(self) -> None:
        check_stream(self.name, self.period)
        names = [field.name for field in self.fields]
        if not names or len(set(names)) < len(names):
            raise ValueError(f"topic {self.name}: expected fields of different names, got {names}")


def check_stream(name: str, period: int) -> None:
    """Check the name and the period (ticks, 1 or more) of a recorded stream of messages."""
    if not TOPIC_NAME.fullmatch(name):
        raise ValueError(f"topic name {name!r}: expected words joined by slashes, such as drive/1")
    if period < 1:
        raise ValueError(f"topic {name}: period is {period} ticks, expected 1 or more")


def message_names(topics: Sequence[Topic]) -> list[str]:
    """Return the full protobuf message names of `topics`, in their order; topics with the same fields share one.

    `drive/1` to `drive/3` become `twin.Drive`; a drive with other fields becomes `twin.Drive2`. ValueError: two topics
    of different fields have names that differ only in case or slashes.
    """
    names: dict[tuple[Field, ...], str] = {}
    for topic in topics:
        words = [word.capitalize() for word in topic.name.replace("_", "/").split("/")]
        candidates = ("".join(w for w in words if not w.isdigit()), "".join(words))
        if topic.fields not in names:
            free = [c for c in candidates if f"{PROTO_PACKAGE}.{c}" not in names.values()]
            if not free:
                raise ValueError(f"topic {topic.name}: type {candidates[-1]} has other fields already")
            names[topic.fields] = f"{PROTO_PACKAGE}.{free[0]}"
    return [names[topic.fields] for topic in topics]


def descriptor_set(message_name: str, fields: Sequence[Field]) -> bytes:
    """Describe the message type `message_name` as a serialised protobuf FileDescriptorSet."""
    simple_name = message_name.removeprefix(f"{PROTO_PACKAGE}.")
    file = FileDescriptorProto(name=f"{PROTO_PACKAGE}/{simple_name}.proto", package=PROTO_PACKAGE, syntax="proto3")
    message = file.message_type.add(name=simple_name)
    known = Counter(_json_name(field.name) for field in fields)
    for index, field in enumerate(fields):
        # JSON names must be unique; protobuf's default is the field name without underscores
        own = {"json_name": field.name} if known[_json_name(field.name)] > 1 else {}
        repeated = field.size > 1
        label = FieldDescriptorProto.LABEL_REPEATED if repeated else FieldDescriptorProto.LABEL_OPTIONAL
        message.field.add(name=field.name, number=index + 1, type=PROTOBUF_TYPES[field.kind], label=label, **own)
        file.source_code_info.location.add(
            path=[MESSAGE_TYPE_NUMBER, 0, FIELD_NUMBER, index],
            span=[index, 0, 0],
            # an FMU's texts may have line ends, which `descriptor_fields` refuses
            leading_comments=CONTROL_CHARACTERS.sub(
                lambda found: repr(found[0])[1:-1], f"{field.unit}: {field.meaning}"
            ),
            trailing_comments=f"{field.size} values" if repeated else "",
        )
    return FileDescriptorSet(file=[file]).SerializeToString(deterministic=True)


def _json_name(name: str) -> str:
    """Return protobuf's default JSON name of the field `name`: `tipSpeed` for `tip_speed`."""
    first, *others = name.split("_")
    return first + "".join(word[:1].upper() + word[1:] for word in others)


def descriptor_fields(message_name: str, descriptors: bytes) -> tuple[Field, ...]:
    """Read the fields of message type `message_name` from its FileDescriptorSet; inverse of `descriptor_set`.

    ValueError, DecodeError of google.protobuf: not a message type of numeric fields with units, meanings and sizes.
    """
    files = FileDescriptorSet.FromString(descriptors).file
    messages = {f"{f.package}.{m.name}": (f, i, m) for f in files for i, m in enumerate(f.message_type)}
    if message_name not in messages:
        raise ValueError(f"message type {message_name} is missing from its own schema")
    file, position, message = messages[message_name]
    comments = {tuple(location.path): location for location in file.source_code_info.location}
    fields = []
    for index, field in enumerate(message.field):
        comment = comments.get((MESSAGE_TYPE_NUMBER, position, FIELD_NUMBER, index))
        if comment is None or field.number != index + 1 or field.type not in FIELD_KINDS:
            raise ValueError(f"field {field.name} of {message_name} is not one that twin writes")
        # protobuf returns strings that are not UTF-8 as bytes
        if not all(isinstance(text, str) for text in (field.name, comment.leading_comments, comment.trailing_comments)):
            raise ValueError(f"a field of {message_name} has a name or comment that is not UTF-8")
        unit, _, meaning = comment.leading_comments.partition(": ")
        repeated = field.label == FieldDescriptorProto.LABEL_REPEATED
        size = int(comment.trailing_comments.split()[0]) if repeated else 1
        if not 1 <= size <= MAX_FIELD_SIZE or CONTROL_CHARACTERS.search(unit + meaning):
            raise ValueError(f"field {field.name} of {message_name} is not one that twin writes")
        fields.append(Field(field.name, size, FIELD_KINDS[field.type], unit, meaning))
    return tuple(fields)


def log_message(time: int, level: str, text: str, name: str) -> bytes:
    """Encode an event as `foxglove.Log`, the message type of `/events`, at `time` (ns); see `Event`."""
    log = Log(level=Log.Level.Value(level.upper()), message=text, name=name)
    log.timestamp.FromNanoseconds(time)
    return log.SerializeToString(deterministic=True)


def descriptors_of(message_type: Descriptor) -> bytes:
    """Return the serialised FileDescriptorSet of an existing protobuf message type, with the files it depends on."""
    files: dict[str, FileDescriptor] = {}

    def collect(file: FileDescriptor) -> None:
        for dependency in file.dependencies:
            collect(dependency)
        files.setdefault(file.name, file)

    collect(message_type.file)
    found = FileDescriptorSet()
    for file in files.values():
        file.CopyToProto(found.file.add())
    return found.SerializeToString(deterministic=True)


@entry("int", "int", "int", "int", "int", "integers", "int", "doubles", "int", "integers", "int")
def _fill(records, count, stride, template, times, first_sequence, rows, step, places, number):
    at, row, place = carray(times, count), carray(rows, count * step), carray(places, number * 3)
    for i in range(count):
        to = records + i * stride
        copy(to, template, stride)
        store_number(to + SEQUENCE_AT, np.uint32(first_sequence + i))
        store_number(to + LOG_TIME_AT, at[i])
        store_number(to + PUBLISH_TIME_AT, at[i])
        for k in range(number):
            kind, column, where = place[3 * k], place[3 * k + 1], to + place[3 * k + 2]
            if kind == DOUBLE_PLACE:
                store_number(where, row[i * step + column])
            elif kind == BOOL_PLACE:
                store_number(where, np.uint8(row[i * step + column] != 0.0))
            elif kind == INTEGER_PLACE:
                value = row[i * step + column]
                # integers beyond int64, and NaN, cannot be stored
                if not -(2.0**63) <= value < 2.0**63 or value != np.floor(value):
                    return 0
                store_number(where, np.int64(value))
            else:
                rest = at[i] // NS_PER_S if kind == SECONDS_PLACE else at[i] % NS_PER_S
                for group in range(TIME_GROUPS):
                    more = 0x80 if group < TIME_GROUPS - 1 else 0
                    store_number(where + group, np.uint8(rest >> 7 * group & 0x7F | more))
    return 1


class Filling:
    """A message record (stride,) uint8 without sequence number, times and numbers, and their places (see the module).

    Writes many records from rows quickly. `fields` are empty for a form.
    """

    def __init__(self, template: np.ndarray, places: np.ndarray, fields: Sequence[Field] = ()):
        self.template, self._places, self._fields = template, places, fields
        self._template_at, self._places_at = template.ctypes.data, places.ctypes.data

    def fill(self, to: int, times: int, count: int, first_sequence: int, rows: np.ndarray) -> None:
        """Write `count` message records at address `to`.

        `times` is the address of the log and publish times, ns, (count,) int64. `rows` are (count, columns) float64, in
        the order of the fields, a bool true if not zero. ValueError: an `int` field gets no integer (NaN included).
        """
        if rows.dtype != FLOAT_TYPE or rows.strides[1] != FLOAT_BYTES or rows.strides[0] % FLOAT_BYTES:
            rows = np.ascontiguousarray(rows, dtype=FLOAT_TYPE)
        stride, step = len(self.template), rows.strides[0] // FLOAT_BYTES
        # pass addresses only: the entry would check every argument for arrays
        if not _fill.native.c_function(
            to, count, stride, self._template_at, times, first_sequence, address_of(rows[:1]), step,
            self._places_at, len(self._places),
        ):  # fmt: skip
            raise ValueError(_no_integer_message(self._fields, rows))

    def __reduce__(self) -> tuple[type["Filling"], tuple[np.ndarray, np.ndarray, Sequence[Field]]]:
        """Pickle the template without addresses, which differ in another process."""
        return Filling, (self.template, self._places, self._fields)

    def records(self, times: np.ndarray, first_sequence: int, rows: np.ndarray) -> np.ndarray:
        """Make a record per element of `times` (ns), (n, stride) uint8; `rows` and ValueError as for `fill`."""
        times = np.ascontiguousarray(times, dtype=np.int64)
        records = np.empty((len(times), len(self.template)), dtype=np.uint8)
        self.fill(records.ctypes.data, times.ctypes.data, len(times), first_sequence, rows)
        return records


@dataclass(frozen=True)
class MessageLayout:
    """Layout of the bytes of one topic's message records in the file, each `stride` bytes long.

    `filling` is a record with every number zero: tags, lengths and channel only. `framing` are slices without numbers,
    equal in every message. `head` and `values` are structured dtypes of the front and of the numbers, by field name.
    """

    filling: Filling
    framing: tuple[slice, ...]
    head: np.dtype
    values: np.dtype

    @property
    def stride(self) -> int:
        """Number of bytes from one message record to the next."""
        return self.values.itemsize


def message_layout(channel: int, fields: Sequence[Field]) -> MessageLayout:
    """Return the byte layout of the message records of channel number `channel`, with these `fields`."""
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
    filling = Filling(record_template(channel, bytes(record[HEAD_SIZE:])), places, fields)
    return MessageLayout(filling, tuple(framing), head_dtype(len(record)), values)


def head_dtype(stride: int) -> np.dtype:
    """Return the structured dtype of the front (sequence number, times) of a message record of `stride` bytes."""
    return np.dtype({"names": HEAD_NAMES, "formats": HEAD_FORMATS, "offsets": HEAD_OFFSETS, "itemsize": stride})


def record_template(channel: int, body: bytes) -> np.ndarray:
    """Make a message record of `body` on `channel`, (stride,) uint8, without sequence number and times."""
    template = np.frombuffer(bytearray(HEAD_SIZE) + body, dtype=np.uint8)
    front = template.view(head_dtype(len(template)))
    front["opcode"], front["length"], front["channel"] = Opcode.MESSAGE, len(template) - RECORD_PREFIX, channel
    return template


def _no_integer_message(fields: Sequence[Field], rows: np.ndarray) -> str:
    """Return the error message for the first value of `rows` that is not an integer but belongs to an `int` field."""
    start = 0
    for field in fields:
        values = rows[:, start : start + field.size]
        # values beyond 2^63 are whole but do not fit an int64
        wrong = values[~((values == np.floor(values)) & (values >= -(2.0**63)) & (values < 2.0**63))]
        if field.kind == "int" and wrong.size:
            return f"field {field.name} holds whole numbers, got {wrong[0]}"
        start += field.size
    raise AssertionError("every integer is one")


def varint(number: int) -> bytes:
    """Encode `number` as protobuf's base-128 variable-length integer, least significant group first."""
    groups = []
    while number > 0x7F:
        groups.append(number & 0x7F | 0x80)
        number >>= 7
    return bytes([*groups, number])


def blank_value(column: int) -> float:
    """Return the number that marks the place of `column` of the rows in an example message."""
    return struct.unpack("<d", struct.pack("<II", column, BLANK_BITS))[0]


@dataclass(frozen=True)
class MessageForm:
    """A recorded stream, one every `period` ticks, of a viewer's messages that differ only in times and numbers.

    The name, `tf`, lacks the leading slash that it has in the file. `example` has `BLANK_TIME`, and the `blank_value`
    of each of the `width` columns of rows passed to `Writer.write`, at least once, in fields of type double.
    """

    name: str
    example: Message
    width: int
    period: int

    def __post_init__(self) -> None:
        check_stream(self.name, self.period)


def form_filling(channel: int, form: MessageForm) -> Filling:
    """Make the record template of a form, for times from 0 to 2^34 s; ValueError: a column without blank."""
    body = form.example.SerializeToString(deterministic=True)
    doubles = [struct.pack("<d", blank_value(column)) for column in range(form.width)]
    found = [(column, place) for column, double in enumerate(doubles) for place in _places(body, double)]
    missing = set(range(form.width)) - {column for column, _ in found}
    if missing:
        raise ValueError(f"form {form.name}: columns {sorted(missing)} have no blank in the example")
    places = [(DOUBLE_PLACE, column, place) for column, place in found]
    for place in _places(body, TIME_BYTES):
        places += [(SECONDS_PLACE, 0, place + SECONDS_AT), (NANOS_PLACE, 0, place + NANOS_AT)]
    table = np.array(places, dtype=np.int64).reshape(-1, 3) + np.array([0, 0, HEAD_SIZE])
    return Filling(record_template(channel, body), table)


def _places(body: bytes, wanted: bytes) -> Iterator[int]:
    place = body.find(wanted)
    while place >= 0:
        yield place
        place = body.find(wanted, place + len(wanted))
