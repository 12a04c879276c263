"""What a recording holds: topics of named, unit-carrying fields."""

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.descriptor import Descriptor, FileDescriptor
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet

from twin.kernel.errors import InputRefused, NotWritten


class RecordingFailed(NotWritten):
    """A recording could not be written: disk full, no permission; what was written stays readable."""


class RecordingRefused(InputRefused):
    """A file is not a recording that can be read: missing, empty, not MCAP, or of another layout."""


class RecordingDamaged(RecordingRefused):
    """A recording's bytes are not those that were written; `salvage=True` reads what precedes the damage."""


class UnknownSeries(RecordingRefused, KeyError):
    """A recording was asked for a topic or field it does not hold.

    Args:
        sentence: for the user.
        key: what was asked for.
    """

    def __init__(self, sentence: str, key: str):
        super().__init__(sentence, key)
        self.key = key

    def __str__(self) -> str:
        # KeyError prints the repr of its argument, with quotes and escapes; the user gets the sentence
        return str(self.args[0])


Kind = Literal["double", "int", "bool"]

# field names become protobuf identifiers; topic names become `/name` with slashes inside
FIELD_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
TOPIC_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*(/[A-Za-z0-9_]+)*")


@dataclass(frozen=True)
class Field:
    """One quantity of a topic.

    Attributes:
        name: a letter, then letters, digits and underscores: `F_ee_B`.
        size: number of values in every message; 1 is a scalar.
        kind: `double`, `int` (64 bit, for counts) or `bool`.
        unit: SI unit, `1` where there is none.
        meaning: one sentence for whoever opens the file, with frame and sign.

    Raises:
        ValueError: a name, size or kind that no message can have.
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
    """A stream of messages of one shape at one period.

    Attributes:
        name: without the leading slash that it has in the file: `plant`, `drive/1`.
        fields: in the order of the columns of the rows handed to `Writer.write`.
        period: ticks from one message to the next; 1 is every tick.

    Raises:
        ValueError: a name, period or list of fields that no topic can have.
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
    """Refuse what no stream of messages can be: a `name` that is none, a `period` (ticks) of less than 1.

    Raises:
        ValueError: it is that.
    """
    if not TOPIC_NAME.fullmatch(name):
        raise ValueError(f"topic name {name!r}: expected words joined by slashes, such as drive/1")
    if period < 1:
        raise ValueError(f"topic {name}: period is {period} ticks, expected 1 or more")


PACKAGE = "twin"
# sfixed64 rather than int64: counts of any value take 8 bytes, so messages have one length
PROTOBUF_TYPES: dict[Kind, FieldDescriptorProto.Type.ValueType] = {
    "double": FieldDescriptorProto.TYPE_DOUBLE,
    "int": FieldDescriptorProto.TYPE_SFIXED64,
    "bool": FieldDescriptorProto.TYPE_BOOL,
}
KINDS: dict[int, Kind] = {number: kind for kind, number in PROTOBUF_TYPES.items()}
CONTROLS = re.compile(r"[\x00-\x1f\x7f-\x9f]")
"""Characters that a terminal may obey."""
LARGEST_FIELD = 10_000
"""Values of a field; a schema must not ask for any amount of memory."""
# field numbers of `message_type` in FileDescriptorProto and of `field` in DescriptorProto, for source paths
MESSAGE_TYPE, FIELD = 4, 2


def message_names(topics: Sequence[Topic]) -> list[str]:
    """Full names of the message types of `topics`, in their order; topics with the same fields share one.

    `drive/1` to `drive/3` become `twin.Drive`; one of them with other fields becomes `twin.Drive2`.

    Raises:
        ValueError: two topics of different fields have names that differ only in case or slashes.
    """
    names: dict[tuple[Field, ...], str] = {}
    for topic in topics:
        words = [word.capitalize() for word in topic.name.replace("_", "/").split("/")]
        candidates = ("".join(w for w in words if not w.isdigit()), "".join(words))
        if topic.fields not in names:
            free = [c for c in candidates if f"{PACKAGE}.{c}" not in names.values()]
            if not free:
                raise ValueError(f"topic {topic.name}: type {candidates[-1]} has other fields already")
            names[topic.fields] = f"{PACKAGE}.{free[0]}"
    return [names[topic.fields] for topic in topics]


def descriptor_set(message_name: str, fields: Sequence[Field]) -> bytes:
    """Serialised FileDescriptorSet of the message type `message_name` with `fields`, numbered from 1."""
    simple_name = message_name.removeprefix(f"{PACKAGE}.")
    file = FileDescriptorProto(name=f"{PACKAGE}/{simple_name}.proto", package=PACKAGE, syntax="proto3")
    message = file.message_type.add(name=simple_name)
    known = Counter(_json_name(field.name) for field in fields)
    for index, field in enumerate(fields):
        # no two fields may have one name in JSON, which by default is that without underscores
        own = {"json_name": field.name} if known[_json_name(field.name)] > 1 else {}
        repeated = field.size > 1
        label = FieldDescriptorProto.LABEL_REPEATED if repeated else FieldDescriptorProto.LABEL_OPTIONAL
        message.field.add(name=field.name, number=index + 1, type=PROTOBUF_TYPES[field.kind], label=label, **own)
        file.source_code_info.location.add(
            path=[MESSAGE_TYPE, 0, FIELD, index],
            span=[index, 0, 0],
            leading_comments=f"{field.unit}: {field.meaning}",
            trailing_comments=f"{field.size} values" if repeated else "",
        )
    return FileDescriptorSet(file=[file]).SerializeToString(deterministic=True)


def _json_name(name: str) -> str:
    """What protobuf calls the field `name` in JSON unless it is told otherwise: `thetaM` for `theta_m`."""
    first, *others = name.split("_")
    return first + "".join(word[:1].upper() + word[1:] for word in others)


def described_fields(message_name: str, descriptors: bytes) -> tuple[Field, ...]:
    """Fields of the message type `message_name`: `descriptor_set` backwards.

    Raises:
        ValueError: not a message type of numeric fields with units, meanings and sizes as described above.
            google.protobuf's DecodeError is not a ValueError and is passed on.
    """
    files = FileDescriptorSet.FromString(descriptors).file
    messages = {f"{f.package}.{m.name}": (f, i, m) for f in files for i, m in enumerate(f.message_type)}
    if message_name not in messages:
        raise ValueError(f"message type {message_name} is missing from its own schema")
    file, position, message = messages[message_name]
    comments = {tuple(location.path): location for location in file.source_code_info.location}
    fields = []
    for index, field in enumerate(message.field):
        comment = comments.get((MESSAGE_TYPE, position, FIELD, index))
        if comment is None or field.number != index + 1 or field.type not in KINDS:
            raise ValueError(f"field {field.name} of {message_name} is not one that twin writes")
        # protobuf hands out what is not UTF-8 as bytes
        if not all(isinstance(text, str) for text in (field.name, comment.leading_comments, comment.trailing_comments)):
            raise ValueError(f"a field of {message_name} has a name or comment that is not UTF-8")
        unit, _, meaning = comment.leading_comments.partition(": ")
        repeated = field.label == FieldDescriptorProto.LABEL_REPEATED
        size = int(comment.trailing_comments.split()[0]) if repeated else 1
        if not 1 <= size <= LARGEST_FIELD or CONTROLS.search(unit + meaning):
            raise ValueError(f"field {field.name} of {message_name} is not one that twin writes")
        fields.append(Field(field.name, size, KINDS[field.type], unit, meaning))
    return tuple(fields)


def log_descriptor_set() -> bytes:
    """Serialised FileDescriptorSet of `foxglove.Log`, the type of `/events`."""
    return descriptors_of(Log.DESCRIPTOR)


def descriptors_of(message_type: Descriptor) -> bytes:
    """Serialised FileDescriptorSet of a message type that exists, with the files it depends on before its own."""
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
