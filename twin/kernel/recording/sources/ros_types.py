"""The types of ROS 2 without ROS: names on the wire, definitions, and classes that DDS makes topics of.

Names: https://design.ros2.org/articles/topic_and_service_names.html. A DDS topic is matched by its name and the name of
its type; rmw_zenoh puts both and the hash of the type (RIHS01, REP 2016) into a key.
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
"""The types that ROS 2 itself has."""


def ros_name(kind: str) -> str:
    """`sensor_msgs::msg::dds_::JointState_` -> `sensor_msgs/msg/JointState`; another name as it is."""
    parts = kind.split("::")
    if len(parts) == 4 and parts[2] == "dds_" and parts[3].endswith("_"):
        return f"{parts[0]}/{parts[1]}/{parts[3][:-1]}"
    return kind


def describe_topic(where: str, topic: str, kind: str) -> ForeignTopic:
    """`topic` of the type `kind`, with the definition of that.

    Raises:
        LogRefused: ROS 2 itself has no such type; the sentence begins with `where`.
    """
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
    """A class of cyclonedds for messages of the type `kind`; equal ones for equal names."""
    from cyclonedds.idl import make_idl_struct

    package, folder, name = kind.split("/")
    fields = {field: _idl_type(what) for field, what in TYPE_STORE.fielddefs[kind][1]}
    return make_idl_struct(f"{name}_", f"{package}.{folder}.dds_.{name}_", fields)


def _idl_type(description: Any) -> Any:
    import cyclonedds.idl.types as cyclone

    # they are written with an index, of which their annotations know nothing
    types: Any = cyclone

    node, what = description
    if node == Nodetype.NAME:
        return idl_class(what)
    if node == Nodetype.BASE:
        plain = {"bool": bool, "string": str, "byte": types.uint8, "octet": types.uint8, "char": types.uint8}
        return plain.get(what[0]) or getattr(types, what[0])
    inner, length = _idl_type(what[0]), what[1]
    return types.array[inner, length] if node == Nodetype.ARRAY else types.sequence[inner]
