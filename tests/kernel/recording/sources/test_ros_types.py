"""Types of ROS 2 without ROS, beside Cyclone DDS, which is not ours."""

import pytest
from rosbags.typesys import Stores, get_typestore

from tests.kernel.recording.logs.bags import joints
from twin.kernel.recording.sources.ros_types import MESSAGE_TYPES, idl_class, ros_name

pytest.importorskip("cyclonedds")


def test_every_message_of_ros_2_becomes_a_type_of_dds_and_its_name_comes_back():
    assert len(MESSAGE_TYPES) > 160
    for kind in MESSAGE_TYPES:
        made = idl_class(kind)
        made.__idl__.populate()
        package, folder, name = kind.split("/")
        assert made.__idl__.idl_transformed_typename == f"{package}::{folder}::dds_::{name}_"
        assert ros_name(made.__idl__.idl_transformed_typename) == kind


def test_cyclone_reads_with_a_made_type_what_rosbags_writes():
    data = bytes(
        get_typestore(Stores.LATEST).serialize_cdr(joints(5.25, l1=0.1, m1=-2.0), "sensor_msgs/msg/JointState")
    )
    found = idl_class("sensor_msgs/msg/JointState").deserialize(data)
    assert (list(found.name), list(found.position)) == (["l1", "m1"], [0.1, -2.0])
    assert (found.header.stamp.sec, found.header.stamp.nanosec) == (5, 250_000_000)
    assert found.serialize() == data


def test_a_name_that_is_none_of_ros_stays_as_it_is():
    assert ros_name("ShapeType") == "ShapeType"
