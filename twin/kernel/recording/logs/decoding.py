"""Decoding of foreign messages: protobuf by the schema in the file, JSON, CDR of ROS 2.

Encodings: https://mcap.dev/spec/registry; CDR: OMG DDSI-RTPS 10.2. mcap-protobuf-support and rosbags decode; the cost
of a definition is bounded here. Units follow REP 103.
"""

import json
import keyword
import math
import re
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from typing import Any

import numpy as np
import zstandard
from google.protobuf.message import DecodeError, Message
from mcap.exceptions import McapError
from mcap.records import Channel, Schema
from mcap_protobuf.decoder import DecoderFactory

from twin.kernel.errors import nearest

Decoder = Callable[[bytes], Any]
SECOND_FIELDS, NANOSECOND_FIELDS = ("seconds", "sec", "secs"), ("nanos", "nanosec", "nsec", "nsecs")
"""Fields of a stamp: google.protobuf.Timestamp, ROS 2 and ROS 1."""
LABEL_FIELDS = ("name", "names", "joint_names")
"""Fields with the names of the elements of sibling arrays: JointState, and messages of ros2_control."""
MAX_SCHEMA_BYTES = 2**20
"""Maximum size of a protobuf schema (bytes); all its types are created, 30 us each, of at least 6 bytes."""

ROS_ENCODINGS = ("ros2msg", "ros2idl")
ROSBAGS_REMEDY = (
    "its messages are those of ROS 2 (CDR), which needs rosbags; install it with: pip install 'rosbags>=0.11'"
)
MISSING_TYPE_REMEDY = (
    "is lacking, and ROS 2 itself has no such type; put its file into the bag's folder as PACKAGE/msg/NAME.msg, with "
    "those of the types in it"
)
MAX_DEFINITION_LENGTH = 2**18
"""Maximum length of a definition (characters); usual ones have some thousands."""
MAX_MESSAGE_BYTES = 2**26
"""Maximum size of a decompressed message (bytes)."""
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
MAX_PARTS = 4096
"""Maximum number of strings and messages in fixed-size arrays of a definition; number arrays may have any length."""
MAX_DEPTH = 24
"""Maximum nesting of messages."""

FIELD_UNITS = {
    ("sensor_msgs/msg/JointState", "position"): "rad",
    ("sensor_msgs/msg/JointState", "velocity"): "rad/s",
    ("sensor_msgs/msg/JointState", "effort"): "N m",
    ("geometry_msgs/msg/Wrench", "force"): "N",
    ("geometry_msgs/msg/Wrench", "torque"): "N m",
    ("geometry_msgs/msg/Pose", "position"): "m",
    ("geometry_msgs/msg/PointStamped", "point"): "m",
    ("geometry_msgs/msg/Transform", "translation"): "m",
    ("geometry_msgs/msg/Twist", "linear"): "m/s",
    ("geometry_msgs/msg/Twist", "angular"): "rad/s",
    ("geometry_msgs/msg/Accel", "linear"): "m/s2",
    ("geometry_msgs/msg/Accel", "angular"): "rad/s2",
    ("sensor_msgs/msg/Imu", "angular_velocity"): "rad/s",
    ("sensor_msgs/msg/Imu", "linear_acceleration"): "m/s2",
}
"""Unit at or below a field of a type: REP 103, and for revolute joints the comments of JointState."""

# IDL constants are evaluated while parsing: powers grow without limit, and each bracket doubles the time
_COSTLY_CONSTANT = re.compile(r"<<|\*|\([^()]*\(")
_TEXT_OR_COMMENT = re.compile(r'"(?:\\.|[^"\\])*"|/\*.*?\*/|//[^\n]*', re.DOTALL)
PATH_PART = re.compile(r'"([^"]+)"|([^.\[\]"][^.\[\]]*)|\[(\d+)\]')


def decoder(channel: Channel, schema: Schema | None) -> Decoder | None:
    """Create an MCAP channel's decoder, None for an unsupported encoding; ValueError for an invalid schema or bytes."""
    if channel.message_encoding == "json":
        return _decode_json
    if schema is None:
        return None
    if channel.message_encoding == "cdr":
        return _ros_decoder(schema.name, schema.encoding, schema.data)
    if len(schema.data) > MAX_SCHEMA_BYTES:
        raise ValueError(f"its schema {schema.name} has {len(schema.data)} bytes, more than {MAX_SCHEMA_BYTES}")
    try:
        decode = DecoderFactory().decoder_for(channel.message_encoding, schema)
    # the last two: contradictory or recursive schemas
    except (DecodeError, McapError, KeyError, TypeError, RecursionError) as problem:
        raise ValueError(f"its schema {schema.name} cannot be used: {problem}") from None
    if decode is None:
        return None

    def decoded(data: bytes) -> Message:
        try:
            return decode(data)
        except DecodeError as problem:
            raise ValueError(str(problem)) from None

    return decoded


def _decode_json(data: bytes) -> Any:
    try:
        return json.loads(data)
    except RecursionError:
        raise ValueError("nested too deeply") from None


def _ros_decoder(name: str, encoding: str, definition: bytes) -> Decoder:
    """Create the decoder of ROS 2 CDR messages of type `name`, as `sensor_msgs/msg/JointState`.

    It raises ValueError for invalid bytes. ROS 2's own types have no definition; others in one of `ROS_ENCODINGS`.
    """
    try:
        from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore
    except ImportError:
        raise ValueError(ROSBAGS_REMEDY) from None
    store, known = get_typestore(Stores.EMPTY), dict(get_typestore(Stores.LATEST).fielddefs)
    wrong = f"is no {encoding}"
    try:
        if definition:
            text = _definition_text(definition, encoding)
            known |= get_types_from_idl(text) if encoding == "ros2idl" else get_types_from_msg(text, name)
        wrong = "cannot be used"
        store.register({one: known[one] for one in _type_closure(name, known) if one not in store.fielddefs})
        store.get_msgdef(name)
    # rosbags raises various exceptions for invalid definitions
    except Exception as problem:
        what = problem if isinstance(problem, _DefinitionError) else wrong
        raise ValueError(f"the definition of {name} in the file {what}") from None

    def decoded(data: bytes) -> Any:
        try:
            data = _decompress(data)
            return store.deserialize_cdr(data, name)
        # as above
        except Exception:
            raise ValueError(f"not a {name} as its definition has it: {_decode_problem(data)}") from None

    return decoded


def is_known(name: str) -> bool:
    """Check whether ROS 2 itself defines the message type `name`; false without rosbags."""
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        return False
    return name in get_typestore(Stores.LATEST).fielddefs


def unit_of(message: Any, parts: Sequence[str | int]) -> str:
    """Look up the unit of the field at `parts` of a decoded message in `FIELD_UNITS`; empty for an unknown field."""
    unit, value = "", message
    for part in parts:
        kind = getattr(value, "__msgtype__", None)
        if kind is None:
            break
        unit = FIELD_UNITS.get((kind, str(part)), unit)
        value = getattr(value, str(part), None)
    return unit


class _DefinitionError(ValueError):
    """Error for an invalid message definition; its text completes a sentence."""


def _definition_text(definition: bytes, encoding: str) -> str:
    if encoding not in ROS_ENCODINGS:
        raise _DefinitionError(f"is written in '{encoding}'; ros2msg and ros2idl are read")
    if len(definition) > MAX_DEFINITION_LENGTH:
        raise _DefinitionError(f"has {len(definition)} letters, more than {MAX_DEFINITION_LENGTH}")
    text = definition.decode("utf-8")
    if encoding == "ros2idl" and _COSTLY_CONSTANT.search(_TEXT_OR_COMMENT.sub("", text)):
        raise _DefinitionError("works out a constant by *, << or brackets in brackets, which is not read")
    return text


def _type_closure(name: str, known: Mapping[str, Any]) -> list[str]:
    parts, found, level = 0, [name], [name]
    for _ in range(MAX_DEPTH):
        inner = []
        for outer in level:
            if outer not in known:
                raise _DefinitionError(f"lacks {outer}" if outer != name else MISSING_TYPE_REMEDY)
            for kind, count in _members(known[outer][1]):
                parts += count
                inner.append(kind)
        if parts > MAX_PARTS:
            raise _DefinitionError(f"has more than {MAX_PARTS} strings or messages in arrays of fixed length")
        level = list(dict.fromkeys(kind for kind in inner if kind))
        if not level:
            return list(dict.fromkeys(found))
        found += level
    raise _DefinitionError("holds itself, or messages more than 24 deep")


def _members(fields: Any) -> Iterator[tuple[str, int]]:
    """Yield message type ("" for others) and fixed array length of each field of a definition."""
    from rosbags.interfaces import Nodetype

    for _, (node, what) in fields:
        count = 0
        if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            fixed = node == Nodetype.ARRAY
            (node, what), length = what
            numbers = node == Nodetype.BASE and what[0] != "string"
            count = length if fixed and not numbers else 0
            if length < 0:
                raise _DefinitionError(f"has an array of {length} elements")
        yield (what if node == Nodetype.NAME else ""), count


def _decompress(data: bytes) -> bytes:
    """Decompress a message if the recorder compressed single messages; CDR cannot be mistaken for compressed data."""
    if not data.startswith(ZSTD_MAGIC):
        return data
    if zstandard.frame_content_size(data) > MAX_MESSAGE_BYTES:
        raise ValueError("a bomb")
    return zstandard.decompress(data, max_output_size=MAX_MESSAGE_BYTES)


def _decode_problem(data: bytes) -> str:
    if len(data) < 4:
        return f"it has {len(data)} bytes"
    if data.startswith(ZSTD_MAGIC):
        return f"it does not decompress to at most {MAX_MESSAGE_BYTES // 2**20} MB"
    if data[:2] not in (b"\0\0", b"\0\1"):
        return f"it begins with {bytes(data[:2]).hex(' ')}; plain CDR (00 00 or 00 01) is read"
    return f"its {len(data)} bytes are cut short, or lengths in them are wrong"


class UnknownElement(LookupError):
    """Error for an array element that a message lacks, but another message of the topic may have."""


def path_parts(path: str) -> tuple[str | int, ...]:
    """Split the path of a message field, `position[2]` or `position."arm.knee"`, at brackets and unquoted dots."""
    return tuple(int(index) if index else quoted or name for quoted, name, index in PATH_PART.findall(path))


def path_text(parts: Sequence[str | int]) -> str:
    """Join the parts of a message field's path to text, `joints.position[2]`."""
    return "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in parts).removeprefix(".")


def field_value(message: Any, parts: Sequence[str | int]) -> float:
    """Return the number (or stamp, s) in a message at a path `force.z`, `joint[2]`, `header.stamp`; see `path_parts`.

    `position.knee` is the element of an array at the index of 'knee' in the names of the same message. The rest of the
    path may be one name, such as `arm.knee`. Null is NaN. LookupError: messages of this type lack the field; the text
    lists the existing ones. `UnknownElement`: this message lacks it. ValueError: neither a number nor a stamp.
    """
    around: list[Any] = []
    value = message
    for k, part in enumerate(parts):
        if value is None:
            break
        if isinstance(part, str) and _is_array(value):
            value, last = _named_element(value, path_text(parts[k:]), part, around)
            if last:
                break
            continue
        if isinstance(part, int):
            value = _element(value, part)
            continue
        around.append(value)
        names = _field_names(value)
        if isinstance(value, Mapping) and len(parts) > k + 1 and (rest := path_text(parts[k:])) in value:
            value = value[rest]
            break
        # Python keywords have a trailing underscore in a dataclass
        part = f"{part}_" if keyword.iskeyword(part) and f"{part}_" in names else part
        if part not in names:
            text = f"it has {', '.join(names)}" if names else f"nothing lies below '{path_text(parts)}'"
            # the next JSON object may have other fields
            raise (UnknownElement if isinstance(value, Mapping) else LookupError)(text)
        value = _member(value, part)
    if isinstance(value, bool | int | float | np.number | np.bool_):
        try:
            return float(value)
        except OverflowError:
            raise ValueError("a number of more than 300 digits") from None
    if value is None:
        return math.nan
    names = _field_names(value)
    stamp = [next((name for name in words if name in names), None) for words in (SECOND_FIELDS, NANOSECOND_FIELDS)]
    if all(stamp):
        seconds, nanoseconds = (field_value(value, (str(part),)) for part in stamp)
        return seconds + nanoseconds * 1e-9
    got = f"a message of {', '.join(names)}" if names else repr(value)[:40]
    raise ValueError(f"expected a number, got {got}")


def _is_array(value: Any) -> bool:
    return isinstance(value, Sequence | np.ndarray) and not isinstance(value, str | bytes)


def _element(value: Any, index: int) -> Any:
    try:
        return value[index]
    except (TypeError, KeyError):
        raise LookupError(f"no element [{index}]") from None
    except IndexError:
        raise UnknownElement(f"no element [{index}]") from None


def _named_element(value: Any, rest: str, name: str, around: Sequence[Any]) -> tuple[Any, bool]:
    """Find the element `rest`, else `name`, of the array `value` by names in `around`; and whether it is `rest`."""
    choice = f"choose an element with [0] instead of .{name}"
    for message in reversed(around):
        for label in set(_field_names(message)).intersection(LABEL_FIELDS):
            labels = _member(message, label)
            if _is_array(labels) and not len(labels):
                raise UnknownElement(f"its {label} is empty; {choice}")
            if _is_array(labels) and isinstance(labels[0], str):
                found = next((one for one in (rest, name) if one in labels), None)
                if found is None:
                    raise UnknownElement(nearest(name, labels, "there are {}"))
                return _element(value, list(labels).index(found)), found == rest
    raise LookupError(f"an array without names; {choice}")


def _field_names(value: Any) -> Collection[str]:
    if isinstance(value, Mapping):
        return value
    if is_dataclass(value):
        # rosbags stores the type as another attribute
        return [name for name in vars(value) if name != "__msgtype__"]
    return value.DESCRIPTOR.fields_by_name if isinstance(value, Message) else ()


def _member(value: Any, name: str) -> Any:
    return value[name] if isinstance(value, Mapping) else getattr(value, name)
