"""Messages of ROS 2: CDR, taken apart by the definition in the file (ros2msg or ros2idl) or by ROS 2's own.

CDR: OMG DDSI-RTPS 10.2; the definitions: https://mcap.dev/spec/registry. rosbags parses and decodes; what a definition
may ask of it is bounded here, for its decoder is as long as the arrays of a definition say. Units are those of REP 103.
"""

import re
import struct
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

import zstandard

ENCODINGS = ("ros2msg", "ros2idl")
EXTRA = "its messages are those of ROS 2 (CDR), which needs rosbags; install it with: pip install 'rosbags>=0.11'"
ABSENT = (
    "is lacking, and ROS 2 itself has no such type; put its file into the bag's folder as PACKAGE/msg/NAME.msg, with "
    "those of the types in it"
)
LONGEST_DEFINITION = 2**18
"""Letters; a type with all that it is made of has some thousands."""
LARGEST_MESSAGE = 2**26
"""Bytes of a message that was packed."""
ZSTD = b"\x28\xb5\x2f\xfd"
MOST_PARTS = 4096
"""Strings and messages in arrays of fixed length, in all of a definition; arrays of numbers may have any length."""
DEEPEST = 24
"""Messages within each other."""

UNITS = {
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
"""Of what lies at or below a field of a type: REP 103, and for joints that turn the comments of JointState."""

# a constant of IDL is worked out as it is read: powers grow without end, and brackets take twice the time each
_GROWING = re.compile(r"<<|\*|\([^()]*\(")
_NO_CODE = re.compile(r'"(?:\\.|[^"\\])*"|/\*.*?\*/|//[^\n]*', re.DOTALL)


def decoder(name: str, encoding: str, definition: bytes) -> Callable[[bytes], Any]:
    """What makes a message of type `name` from its CDR bytes; it raises ValueError for bytes that are none.

    Args:
        name: of the type, `sensor_msgs/msg/JointState`.
        encoding: one of `ENCODINGS`; anything where the definition is empty, which then is ROS 2's own.

    Raises:
        ValueError: rosbags is not installed; a definition that is none, is lacking or asks for too much.
    """
    try:
        from rosbags.serde import SerdeError
        from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
    except ImportError:
        raise ValueError(EXTRA) from None
    broken = (
        *(SerdeError, TypesysError, ValueError, LookupError, TypeError, AttributeError, SyntaxError, AssertionError),
        *(RecursionError, OverflowError, MemoryError, struct.error),
    )
    stock = get_typestore(Stores.LATEST)
    try:
        own = {}
        if definition:
            text = _text(definition, encoding)
            own = get_types_from_idl(text) if encoding == "ros2idl" else get_types_from_msg(text, name)
    except broken as problem:
        what = problem if isinstance(problem, _Refused) else f"is no {encoding}"
        raise ValueError(f"the definition of {name} in the file {what}") from None
    store = get_typestore(Stores.EMPTY)
    try:
        known = {**stock.fielddefs, **own}
        store.register({one: known[one] for one in _made_of(name, known) if one not in store.fielddefs})
        store.get_msgdef(name)
    except broken as problem:
        what = problem if isinstance(problem, _Refused) else "cannot be used"
        raise ValueError(f"the definition of {name} in the file {what}") from None

    def decoded(data: bytes) -> Any:
        try:
            data = _unpacked(data)
            return store.deserialize_cdr(data, name)
        except broken:
            raise ValueError(f"not a {name} as its definition has it: {_why(data)}") from None

    return decoded


def is_known(name: str) -> bool:
    """Whether ROS 2 itself has the type `name`, so that it needs no definition; False without rosbags, too."""
    try:
        from rosbags.typesys import Stores, get_typestore
    except ImportError:
        return False
    return name in get_typestore(Stores.LATEST).fielddefs


def unit_of(message: Any, parts: Sequence[str | int]) -> str:
    """The unit that `UNITS` gives the field at `parts` of a decoded message; empty if none."""
    unit, value = "", message
    for part in parts:
        kind = getattr(value, "__msgtype__", None)
        if kind is None:
            break
        unit = UNITS.get((kind, str(part)), unit)
        value = getattr(value, str(part), None)
    return unit


class _Refused(ValueError):
    """What a definition may not be, as the end of a sentence about it."""


def _text(definition: bytes, encoding: str) -> str:
    if encoding not in ENCODINGS:
        raise _Refused(f"is written in '{encoding}'; ros2msg and ros2idl are read")
    if len(definition) > LONGEST_DEFINITION:
        raise _Refused(f"has {len(definition)} letters, more than {LONGEST_DEFINITION}")
    text = definition.decode("utf-8")
    if encoding == "ros2idl" and _GROWING.search(_NO_CODE.sub("", text)):
        raise _Refused("works out a constant by *, << or brackets in brackets, which is not read")
    return text


def _made_of(name: str, known: Mapping[str, Any]) -> list[str]:
    """The type `name` and all that it is made of."""
    parts, found, level = 0, [name], [name]
    for _ in range(DEEPEST):
        inner = []
        for outer in level:
            if outer not in known:
                raise _Refused(f"lacks {outer}" if outer != name else ABSENT)
            for kind, count in _members(known[outer][1]):
                parts += count
                inner.append(kind)
        if parts > MOST_PARTS:
            raise _Refused(f"has more than {MOST_PARTS} strings or messages in arrays of fixed length")
        level = list(dict.fromkeys(kind for kind in inner if kind))
        if not level:
            return list(dict.fromkeys(found))
        found += level
    raise _Refused("holds itself, or messages more than 24 deep")


def _members(fields: Any) -> Iterator[tuple[str, int]]:
    """Of each field the type of message, "" for anything else, and how many a fixed array has."""
    from rosbags.interfaces import Nodetype

    for _, (node, what) in fields:
        count = 0
        if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
            fixed = node == Nodetype.ARRAY
            (node, what), length = what
            numbers = node == Nodetype.BASE and what[0] != "string"
            count = length if fixed and not numbers else 0
            if length < 0:
                raise _Refused(f"has an array of {length} elements")
        yield (what if node == Nodetype.NAME else ""), count


def _unpacked(data: bytes) -> bytes:
    """`data`, unpacked if the recorder packed every message by itself, which CDR cannot be mistaken for."""
    if not data.startswith(ZSTD):
        return data
    if zstandard.frame_content_size(data) > LARGEST_MESSAGE:
        raise ValueError("a bomb")
    try:
        return zstandard.decompress(data, max_output_size=LARGEST_MESSAGE)
    except zstandard.ZstdError as problem:
        raise ValueError(str(problem)) from None


def _why(data: bytes) -> str:
    if len(data) < 4:
        return f"it has {len(data)} bytes"
    if data.startswith(ZSTD):
        return f"it does not decompress to at most {LARGEST_MESSAGE // 2**20} MB"
    if data[:2] not in (b"\0\0", b"\0\1"):
        return f"it begins with {bytes(data[:2]).hex(' ')}; plain CDR (00 00 or 00 01) is read"
    return f"its {len(data)} bytes are cut short, or lengths in them are wrong"
