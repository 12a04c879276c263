"""ROS 2 message types without ROS: names on the wire, definitions, and classes for DDS topics.

Names: https://design.ros2.org/articles/topic_and_service_names.html. DDS matches topics by their name and the name of
their type; rmw_zenoh has both and the hash of the type (RIHS01, REP 2016) in a key.
"""

from functools import cache
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_typestore

from twin.kernel.errors import nearest
from twin.kernel.recording.logs.log import LogError
from twin.kernel.recording.writer import ForeignTopic

TYPE_STORE = get_typestore(Stores.LATEST)
MESSAGE_TYPES = [name for name in TYPE_STORE.fielddefs if "/msg/" in name]
"""Message types of ROS 2 itself."""


def ros_name(kind: str) -> str:
    """Convert a DDS type name, `sensor_msgs::msg::dds_::JointState_`, to `sensor_msgs/msg/JointState`; keep others."""
    parts = kind.split("::")
    if len(parts) == 4 and parts[2] == "dds_" and parts[3].endswith("_"):
        return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"
    return kind


def describe_topic(where: str, topic: str, kind: str) -> ForeignTopic:
    """Describe a ROS 2 topic of type `kind`, with its definition; LogError, beginning with `where`, if unknown."""
    if kind not in MESSAGE_TYPES:
        raise LogError(
            f"{where}: {topic} has the type {kind}, which ROS 2 itself has not; "
            f"{nearest(kind, MESSAGE_TYPES, 'it has {}', 3)}; publish one of those, or record a bag, which has "
            "its own definitions, and use --source BAG"
        )
    text, _ = TYPE_STORE.generate_msgdef(kind, ros_version=2)
    return ForeignTopic(topic, "cdr", kind, "ros2msg", text.encode())


@cache
def idl_class(kind: str) -> Any:
    """Create the cyclonedds class for ROS messages of type `kind`; equal names give equal classes."""
    from cyclonedds.idl import make_idl_struct

    package, folder, name = kind.split("/")
    fields = {field: _idl_type(what) for field, what in TYPE_STORE.fielddefs[kind][1]}
    return make_idl_struct(f"{name}_", f"{package}.{folder}.dds_.{name}_", fields)


def _idl_type(description: Any) -> Any:
    import cyclonedds.idl.types as cyclone

    # indexing works at run time, but is not annotated
    types: Any = cyclone

    node, what = description
    if node == Nodetype.NAME:
        return idl_class(what)
    if node == Nodetype.BASE:
        plain = {"bool": bool, "string": str, "byte": types.uint8, "octet": types.uint8, "char": types.uint8}
        return plain.get(what[0]) or getattr(types, what[0])
    inner, length = _idl_type(what[0]), what[1]
    return types.array[inner, length] if node == Nodetype.ARRAY else types.sequence[inner]
