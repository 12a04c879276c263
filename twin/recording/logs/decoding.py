"""Messages of others' logs as numbers: protobuf by the schema in the file, JSON as it is, CDR of ROS 2.

Encodings: https://mcap.dev/spec/registry. A protobuf schema is a serialised FileDescriptorSet.
"""

import json
import keyword
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError, Message
from google.protobuf.message_factory import GetMessageClass
from mcap.records import Channel, Schema

from twin.errors import nearest
from twin.recording.logs import ros_messages

Decoder = Callable[[bytes], Any]
SECONDS, NANOSECONDS = ("seconds", "sec", "secs"), ("nanos", "nanosec", "nsec", "nsecs")
"""Parts of a stamp: google.protobuf.Timestamp, ROS 2 and ROS 1."""
LABELS = ("name", "names", "joint_names")
"""Fields with the names of the elements of the arrays beside them: JointState, and messages of ros2_control."""


def decoder(channel: Channel, schema: Schema | None) -> Decoder | None:
    """What makes a message of `channel` from its bytes; None for an encoding that is not read.

    The decoder raises ValueError for bytes that are no such message; this function raises it for such a schema.
    """
    if channel.message_encoding == "json":
        return _json
    if channel.message_encoding == "cdr" and schema is not None:
        return ros_messages.decoder(schema.name, schema.encoding, schema.data)
    if channel.message_encoding != "protobuf" or schema is None or schema.encoding != "protobuf":
        return None
    try:
        message_type = GetMessageClass(_pool(schema.data).FindMessageTypeByName(schema.name))
    # the last two: what a schema asks for that contradicts itself, or imports itself
    except (DecodeError, KeyError, TypeError, RecursionError) as problem:
        raise ValueError(f"its schema {schema.name} cannot be used: {problem}") from None

    def decoded(data: bytes) -> Message:
        try:
            return message_type.FromString(data)
        except DecodeError as problem:
            raise ValueError(str(problem)) from None

    return decoded


def _json(data: bytes) -> Any:
    try:
        return json.loads(data)
    except RecursionError:
        raise ValueError("nested too deeply") from None


class Unnamed(LookupError):
    """A message has no element of that name; another one of the topic may have."""


def path_parts(path: str) -> tuple[str | int, ...]:
    """`joints.position[2]` -> joints, position, 2."""
    return tuple(int(index) if index else name for name, index in re.findall(r"([^.\[\]]+)|\[(\d+)\]", path))


def field(message: Any, parts: Sequence[str | int]) -> float:
    """The number (or stamp, in s) of a message at `force.z`, `position[2]`, `header.stamp`, as `path_parts` has it.

    `position.knee` is the element of an array that stands where 'knee' stands in the names beside it.

    Raises:
        LookupError: there is no such field; its text says what is there. `Unnamed`: no such name.
        ValueError: what is there is neither a number nor a stamp.
    """
    around: list[Any] = []
    value = message
    for part in parts:
        if isinstance(part, str) and _is_array(value):
            part = _index_of(part, around)
        if isinstance(part, int):
            try:
                value = value[part]
            except (TypeError, IndexError, KeyError):
                raise LookupError(f"no element [{part}]") from None
            continue
        around.append(value)
        members = value if isinstance(value, Mapping) else vars(value) if is_dataclass(value) else None
        if members is not None and part in members:
            value = members[part]
            continue
        names = _names(value)
        # what Python keeps for itself is spelt with a dash below in a dataclass
        part = f"{part}_" if keyword.iskeyword(part) and f"{part}_" in names else part
        if part not in names:
            where = "".join(f"[{p}]" if isinstance(p, int) else f".{p}" for p in parts)[1:]
            raise LookupError(f"it has {', '.join(names)}" if names else f"nothing lies below '{where}'")
        value = getattr(value, part)
    if isinstance(value, bool | int | float | np.number | np.bool_):
        try:
            return float(value)
        except OverflowError:
            raise ValueError("a number of more than 300 digits") from None
    names = _names(value)
    stamp = [next((name for name in words if name in names), None) for words in (SECONDS, NANOSECONDS)]
    if all(stamp):
        seconds, nanoseconds = (field(value, (str(part),)) for part in stamp)
        return seconds + nanoseconds * 1e-9
    got = f"a message of {', '.join(names)}" if names else repr(value)[:40]
    raise ValueError(f"expected a number, got {got}")


def _is_array(value: Any) -> bool:
    return isinstance(value, Sequence | np.ndarray) and not isinstance(value, str | bytes)


def _index_of(name: str, around: Sequence[Any]) -> int:
    """Where `name` stands among the names in the nearest of the messages `around` an array."""
    for message in reversed(around):
        for label in set(_names(message)).intersection(LABELS):
            labels = message[label] if isinstance(message, Mapping) else getattr(message, label)
            if _is_array(labels) and len(labels) and isinstance(labels[0], str):
                if name in labels:
                    return list(labels).index(name)
                raise Unnamed(nearest(name, labels, "there are {}"))
    raise LookupError(f"an array without names beside it; choose an element with [0] instead of .{name}")


def _names(value: Any) -> list[str]:
    if isinstance(value, Mapping):
        return list(value)
    if is_dataclass(value):
        # rosbags keeps the type beside the fields
        return [one.name for one in fields(value) if not one.name.startswith("__")]
    return [f.name for f in value.DESCRIPTOR.fields] if isinstance(value, Message) else []


def _pool(descriptors: bytes) -> DescriptorPool:
    """The types of a FileDescriptorSet, each file after those it imports."""
    files = {file.name: file for file in FileDescriptorSet.FromString(descriptors).file}
    pool = DescriptorPool()

    def add(file: FileDescriptorProto) -> None:
        for name in file.dependency:
            if name in files:
                add(files.pop(name))
        pool.Add(file)

    while files:
        add(files.pop(next(iter(files))))
    return pool
