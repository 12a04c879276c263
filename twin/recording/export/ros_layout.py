"""How signals become messages of ROS 2: standard ones, so that every installation can show and play them.

Positions are PoseStamped, velocities TwistStamped, forces WrenchStamped, what turns JointState, anything else
Float64MultiArray. The definitions: https://github.com/ros2/common_interfaces; CDR: OMG DDSI-RTPS 10.2.
"""

import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from twin.recording.layout import Field

JOINTS = {
    "theta_l": ("joint", "position"),
    "omega_l": ("joint", "velocity"),
    "tau_l": ("joint", "effort"),
    "theta_m": ("motor", "position"),
    "omega_m": ("motor", "velocity"),
    "tau_motor": ("motor", "effort"),
}
"""Whose angle, speed or torque a field is."""
JOINT_FIELDS = ("position", "velocity", "effort")
_HEADER = {
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
}
_VECTOR = {"geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z"}
_JOINT_STATE = "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"
_MADE_OF = {
    "sensor_msgs/msg/JointState": (_JOINT_STATE, _HEADER),
    "geometry_msgs/msg/WrenchStamped": (
        "std_msgs/Header header\ngeometry_msgs/Wrench wrench",
        {**_HEADER, "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque", **_VECTOR},
    ),
    "geometry_msgs/msg/TwistStamped": (
        "std_msgs/Header header\ngeometry_msgs/Twist twist",
        {**_HEADER, "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular", **_VECTOR},
    ),
    "geometry_msgs/msg/PoseStamped": (
        "std_msgs/Header header\ngeometry_msgs/Pose pose",
        {
            **_HEADER,
            "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
            "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
            "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
        },
    ),
    "std_msgs/msg/Float64MultiArray": (
        "std_msgs/MultiArrayLayout layout\nfloat64[] data",
        {
            "std_msgs/MultiArrayLayout": "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset",
            "std_msgs/MultiArrayDimension": "string label\nuint32 size\nuint32 stride",
        },
    ),
}
# of vectors of three: type, the path of its first part, and the numbers after the vector
_VECTORS = {
    "N": ("geometry_msgs/msg/WrenchStamped", "wrench.force", (0.0, 0.0, 0.0)),
    "m/s": ("geometry_msgs/msg/TwistStamped", "twist.linear", (0.0, 0.0, 0.0)),
    # the platform does not turn
    "m": ("geometry_msgs/msg/PoseStamped", "pose.position", (0.0, 0.0, 0.0, 1.0)),
}


@dataclass
class RosTopic:
    """One topic of the bag.

    Attributes:
        name: `/plant/p_B`.
        kind: type of its messages.
        source: topic of the recording.
        body: one message as CDR, with zeros where numbers and times go.
        places: of each number its offset in the body, and which element of which field it is.
        stamp: offset of its stamp, seconds and nanoseconds; 0 if it has none.
        columns: of each element, `plant.p_B[0]`, where it is, `/plant/p_B.pose.position.x`, and its unit.
    """

    name: str
    kind: str
    source: str
    body: bytes = b""
    places: list[tuple[int, str, int]] = field(default_factory=list)
    stamp: int = 0
    columns: dict[str, tuple[str, str]] = field(default_factory=dict)


def definition(kind: str) -> str:
    """The definition of a type with all that it is made of, as MCAP has it (ros2msg)."""
    own, others = _MADE_OF[kind]
    return own + "".join(f"\n{'=' * 80}\nMSG: {name}\n{text}" for name, text in others.items()) + "\n"


def ros_topics(topic: str, fields: Sequence[Field]) -> Iterator[RosTopic]:
    """Topics of the bag that hold `fields` of the recording's `topic`."""
    states: dict[str, dict[str, Field]] = {}
    for one in fields:
        side, part = JOINTS.get(one.name, ("", ""))
        same = states.get(side, {})
        if side and len(_joints(topic, side, one)) and all(one.size == other.size for other in same.values()):
            states.setdefault(side, {})[part] = one
        elif one.size == len("xyz") and one.unit in _VECTORS:
            yield _vector(topic, one)
        else:
            yield _numbers(topic, one)
    for side, parts in states.items():
        yield _joint_state(topic, side, parts)


def _joints(topic: str, side: str, one: Field) -> list[str]:
    """Names of the joints in a field: `joint_1` .. `joint_3`; of `drive/2` `motor_2`."""
    own = topic.rpartition("/")[2]
    if one.size == 1 and own.isdigit():
        return [f"{side}_{own}"]
    return [f"{side}_{k + 1}" for k in range(one.size)] if one.size > 1 else []


def _joint_state(topic: str, side: str, parts: dict[str, Field]) -> RosTopic:
    made = RosTopic(f"/{topic}/{side}_states", "sensor_msgs/msg/JointState", topic)
    cdr = _Cdr(made)
    cdr.header("")
    names = _joints(topic, side, next(iter(parts.values())))
    cdr.count(len(names))
    for name in names:
        cdr.text(name)
    for part in JOINT_FIELDS:
        cdr.count(len(names) if part in parts else 0)
        if part in parts:
            cdr.elements(parts[part], [f"{part}.{name}" for name in names])
    return cdr.done()


def _vector(topic: str, one: Field) -> RosTopic:
    kind, path, rest = _VECTORS[one.unit]
    cdr = _Cdr(RosTopic(f"/{topic}/{one.name}", kind, topic))
    cdr.header("B" if one.name.endswith("_B") else "")
    cdr.elements(one, [f"{path}.{axis}" for axis in "xyz"])
    cdr.constants(rest)
    return cdr.done()


def _numbers(topic: str, one: Field) -> RosTopic:
    cdr = _Cdr(RosTopic(f"/{topic}/{one.name}", "std_msgs/msg/Float64MultiArray", topic))
    cdr.count(1)
    cdr.text(f"{topic}.{one.name} [{one.unit}]")
    # size and stride of the only dimension, offset of its data, and how many follow
    for number in (one.size, one.size, 0, one.size):
        cdr.count(number)
    cdr.elements(one, [f"data[{k}]" for k in range(one.size)])
    return cdr.done()


class _Cdr:
    """A message as it is put together, little endian; numbers stand at multiples of their length after the head."""

    def __init__(self, topic: RosTopic) -> None:
        self._topic = topic
        self._head = b"\0\1\0\0"
        self._body = bytearray()

    def header(self, frame: str) -> None:
        self._topic.stamp = len(self._head) + len(self._body)
        self._body += bytes(8)
        self.text(frame)

    def count(self, number: int) -> None:
        self._align(4)
        self._body += struct.pack("<I", number)

    def text(self, text: str) -> None:
        content = text.encode("utf-8") + b"\0"
        self.count(len(content))
        self._body += content

    def elements(self, one: Field, paths: Sequence[str]) -> None:
        """The numbers of a field, and where in the message they are."""
        self._align(8)
        for k, path in enumerate(paths):
            self._topic.places.append((len(self._head) + len(self._body), one.name, k))
            signal = f"{self._topic.source}.{one.name}" + (f"[{k}]" if one.size > 1 else "")
            self._topic.columns[signal] = (f"{self._topic.name}.{path}", one.unit)
            self._body += bytes(8)

    def constants(self, numbers: Sequence[float]) -> None:
        self._body += struct.pack(f"<{len(numbers)}d", *numbers)

    def done(self) -> RosTopic:
        self._topic.body = self._head + bytes(self._body)
        return self._topic

    def _align(self, size: int) -> None:
        self._body += bytes(-len(self._body) % size)
