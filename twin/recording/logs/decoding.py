"""Messages of foreign MCAP files as numbers: protobuf by the schema in the file, JSON as it is.

Encodings: https://mcap.dev/spec/registry. A protobuf schema is a serialised FileDescriptorSet.
"""

import json
import re
from collections.abc import Callable, Mapping
from typing import Any

from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message import DecodeError, Message
from google.protobuf.message_factory import GetMessageClass
from mcap.records import Channel, Schema

Decoder = Callable[[bytes], Any]
SECONDS, NANOSECONDS = ("seconds", "sec", "secs"), ("nanos", "nanosec", "nsec", "nsecs")
"""Parts of a stamp: google.protobuf.Timestamp, ROS 2 and ROS 1 as JSON."""


def decoder(channel: Channel, schema: Schema | None) -> Decoder | None:
    """What makes a message of `channel` from its bytes; None for an encoding that is not read.

    The decoder raises ValueError for bytes that are no such message; this function raises it for such a schema.
    """
    if channel.message_encoding == "json":
        return _json
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


def field(message: Any, path: str) -> Any:
    """The number (or stamp, in s) at `path` of a message: `force.z`, `position[2]`, `header.stamp`.

    Raises:
        LookupError: there is no such field; its text says what is there.
        ValueError: what is there is neither a number nor a stamp.
    """
    value = message
    for name, index in re.findall(r"([^.\[\]]+)|\[(\d+)\]", path):
        if index:
            try:
                value = value[int(index)]
            except (TypeError, IndexError, KeyError):
                raise LookupError(f"no element [{index}]") from None
        else:
            names = _names(value)
            if name not in names:
                raise LookupError(f"it has {', '.join(names)}" if names else f"nothing lies below '{path}'")
            value = value[name] if isinstance(value, Mapping) else getattr(value, name)
    if isinstance(value, bool | int | float):
        try:
            return float(value)
        except OverflowError:
            raise ValueError("a number of more than 300 digits") from None
    names = _names(value)
    parts = [next((name for name in words if name in names), None) for words in (SECONDS, NANOSECONDS)]
    if all(parts):
        seconds, nanoseconds = (field(value, str(part)) for part in parts)
        return seconds + nanoseconds * 1e-9
    got = f"a message of {', '.join(names)}" if names else repr(value)[:40]
    raise ValueError(f"expected a number, got {got}")


def _names(value: Any) -> list[str]:
    if isinstance(value, Mapping):
        return list(value)
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
