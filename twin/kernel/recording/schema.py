"""Fields as protobuf schemas: a message type per shape, unit and meaning in the comments of its fields.

A schema in an MCAP file is a serialised FileDescriptorSet. Each field carries the leading comment
`unit: meaning`; a field of several values is `repeated`, and since protobuf does not say how many, its
trailing comment does: `3 values`. So the file's own schema is enough to lay its messages out in memory.
"""

import re
from collections import Counter
from collections.abc import Sequence

from foxglove_schemas_protobuf.Log_pb2 import Log
from google.protobuf.descriptor import Descriptor, FileDescriptor
from google.protobuf.descriptor_pb2 import FieldDescriptorProto, FileDescriptorProto, FileDescriptorSet

from twin.kernel.recording.layout import Field, Kind, Topic

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
