"""Messages of a robot as numbers: units, signs, names in any order, stamps, and what does not fit."""

from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_typestore

from tests.kernel.recording.logs.bags import joints, wrench
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import LogError
from twin.kernel.recording.sources.ros_types import describe_topic
from twin.kernel.recording.sources.signals import MessageReader, WantedSignal

STORE = get_typestore(Stores.LATEST)
WANTED = {"a": WantedSignal(0, "rad", 0.5, 100.0), "b": WantedSignal(1, "rad"), "F": WantedSignal(2, "N")}
MAP = ["a=/js.position.m1", "b=-/js.position.l1[deg]"]
JOINTS, WRENCH = "sensor_msgs/msg/JointState", "geometry_msgs/msg/WrenchStamped"


def reader(maps: list[str], kind: str = JOINTS) -> MessageReader:
    columns = column_map(maps)
    time = columns.pop("time", None)
    return MessageReader("robot", describe_topic("robot", "/js", kind), columns, WANTED, time)


def packed(message: Any, kind: str = JOINTS) -> bytes:
    return bytes(STORE.serialize_cdr(message, kind))


def test_units_signs_offsets_and_the_order_of_joints_are_those_of_the_map_and_the_message():
    one = reader(MAP)
    for order in (("m1", "l1", "x"), ("x", "l1", "m1")):
        values = {"m1": 0.25, "l1": 30.0, "x": 9.0}
        found = one.read_message(packed(joints(12.5, **{name: values[name] for name in order})), 1)
        assert (found.stamp, found.columns) == (12_500_000_000, (0, 1))
        assert found.values == pytest.approx((75.0, -np.radians(30.0)))


def test_a_message_with_the_names_of_the_one_before_is_read_as_by_a_reader_that_has_seen_none():
    one = reader(MAP)
    for stamp, names in ((1.0, "m1 l1"), (2.0, "m1 l1"), (3.0, "l1 m1"), (4.0, "l1 m1"), (5.0, "m1"), (6.0, "m1 l1")):
        data = packed(joints(stamp, **{name: stamp + len(name) + k for k, name in enumerate(names.split())}))
        assert one.read_message(data, 7) == reader(MAP).read_message(data, 7)
    shorter = joints(7.0, m1=0.1, l1=0.2)
    shorter.position = shorter.position[:1]
    assert one.read_message(packed(shorter), 8).columns == (0,)


def test_a_joint_that_is_not_named_is_left_out_and_told_until_it_is():
    one = reader(MAP)
    assert one.read_message(packed(joints(1.0, m1=0.1, m2=0.2)), 1).columns == (0,)
    assert one.missing_signals() == ["robot: /js has no 'position.l1' for b; did you mean 'm1'?"]
    one.read_message(packed(joints(2.0, l1=0.1)), 1)
    assert one.missing_signals() == []


@pytest.mark.parametrize(
    ("maps", "kind", "message", "parts"),
    [
        (["a=/js.wrench.force.z"], JOINTS, joints(1.0, m1=0.1), ("has no number 'wrench.force.z' for a", "position")),
        (["a=/js.wrench.force.z"], WRENCH, wrench(1.0, 3.0), ("'a' is in 'N', expected 'rad'", "--map a=")),
        (["F=/js.wrench.torque.z"], WRENCH, wrench(1.0, 3.0), ("is in 'N m', expected 'N'", "--map F=")),
        (["a=/js.position.m1", "time=name"], JOINTS, joints(1.0, m1=0.1), ("has no time 'name'",)),
        (["a=/js.position.m1[furlong]"], JOINTS, joints(1.0, m1=0.1), ("unknown unit 'furlong'",)),
    ],
)
def test_what_does_not_fit_is_told_with_what_is_there(maps: list[str], kind: str, message: Any, parts: tuple[str, ...]):
    with pytest.raises(LogError) as refused:
        reader(maps, kind).read_message(packed(message, kind), 1)
    assert all(part.replace("'a'", "a") in str(refused.value) for part in parts)


def test_bytes_of_another_type_are_refused():
    with pytest.raises(LogError, match="not a sensor_msgs/msg/JointState"):
        reader(MAP).read_message(packed(joints(1.0, m1=0.1))[:20], 1)


def test_a_stamp_that_stays_zero_is_none_and_the_arrival_counts():
    one = reader(MAP)
    found = [one.read_message(packed(joints(0.0, m1=0.1, l1=0.2)), 77 + k) for k in range(4)]
    assert not one.stamped
    assert [(each.stamp, bool(each.columns)) for each in found[2:]] == [(79, True), (80, True)]


def test_a_clock_that_begins_at_zero_is_a_clock():
    one = reader(MAP)
    found = [one.read_message(packed(joints(0.002 * k, m1=0.1, l1=0.2)), 10**18 + k) for k in range(4)]
    assert one.stamped
    assert [each.stamp for each in found[1:]] == [2_000_000, 4_000_000, 6_000_000]


def test_a_type_that_ros_has_not_is_told_with_near_ones():
    with pytest.raises(LogError, match=r"robot_msgs/msg/JointState, which ROS 2 itself has not.*--source BAG"):
        describe_topic("robot", "/js", "robot_msgs/msg/JointState")
