"""Messages of a served robot: what ros2_control sends is read, and what is published is what ROS 2 decodes."""

import math
from typing import Any

import numpy as np
import pytest

from twin.kernel.recording.sources.ros_types import TYPE_STORE
from twin.studies.serve import messages
from twin.studies.serve.messages import JOINT_STATE, SPEED_ARRAY, read_command

MOTORS = ("m1", "m2", "m3")
JOINTS = ("m1", "m2", "m3", "l1", "l2", "l3")
STAMP = 3_000_000_007


@pytest.mark.parametrize(
    ("names", "speeds", "expected"),
    [
        (MOTORS, (1, 2, 3), (1, 2, 3)),
        (("m3", "m1", "m2"), (3, 1, 2), (1, 2, 3)),
        (("l1", "m3", "m1", "m2"), (9, 3, 1, 2), (1, 2, 3)),
        # joint_state_topic_hardware_interface names all joints, and has speeds of those with a velocity command
        (("l1", "m1", "l2", "m2", "l3", "m3"), (1, 2, 3), (1, 2, 3)),
    ],
)
def test_speeds_are_those_of_the_named_motors(
    names: tuple[str, ...], speeds: tuple[float, ...], expected: tuple[float, ...]
):
    found = read_command(messages.joint_state(STAMP, names, velocity=speeds), JOINT_STATE, MOTORS)
    assert (found.stamp, found.mistake) == (STAMP, "")
    assert found.speeds.tolist() == list(expected)


@pytest.mark.parametrize(
    ("names", "speeds", "expected"),
    [
        (MOTORS, (1, 2), "2 velocities of m1, m2, m3; expected m1, m2, m3"),
        (MOTORS, (), "0 velocities of m1, m2, m3"),
        (("m1", "m2", "x"), (1, 2, 3), "3 velocities of m1, m2, x"),
        (("m1", "m2", "m2", "m3"), (1, 2, 3, 4), "4 velocities of m1, m2, m2, m3"),
        ((), (1, 2, 3), "3 velocities of no joint"),
    ],
)
def test_other_names_or_lengths_are_refused_in_a_sentence(
    names: tuple[str, ...], speeds: tuple[float, ...], expected: str
):
    found = read_command(messages.joint_state(STAMP, names, velocity=speeds), JOINT_STATE, MOTORS)
    assert found.mistake.startswith(expected) and np.isnan(found.speeds).all()


def test_not_a_number_is_a_command_for_the_monitor_to_judge():
    found = read_command(messages.joint_state(STAMP, MOTORS, velocity=(1, math.nan, 3)), JOINT_STATE, MOTORS)
    assert found.mistake == "" and math.isnan(found.speeds[1])


@pytest.mark.parametrize("data", [b"", b"\0\1\0\0", b"\0\1\0\0" + b"\xff" * 40])
@pytest.mark.parametrize("kind", [JOINT_STATE, SPEED_ARRAY])
def test_damaged_bytes_are_a_mistake_and_no_exception(data: bytes, kind: str):
    assert read_command(data, kind, MOTORS).mistake.startswith(f"unreadable {kind}")


def array(*numbers: float) -> bytes:
    """A Float64MultiArray as forward_command_controller is commanded with."""
    types = TYPE_STORE.types
    layout = types["std_msgs/msg/MultiArrayLayout"]([], 0)
    return bytes(TYPE_STORE.serialize_cdr(types[SPEED_ARRAY](layout, np.array(numbers, dtype=float)), SPEED_ARRAY))


def test_an_array_has_three_numbers_and_no_stamp():
    found = read_command(array(1, 2, 3), SPEED_ARRAY, MOTORS)
    assert (found.stamp, found.mistake, found.speeds.tolist()) == (None, "", [1, 2, 3])
    assert read_command(array(1, 2), SPEED_ARRAY, MOTORS).mistake == "2 numbers, expected 3"


def test_an_error_message_lists_a_few_names_only():
    many = messages.joint_state(STAMP, ["m"] * 1000, velocity=np.zeros(1000))
    assert read_command(many, JOINT_STATE, MOTORS).mistake == (
        "1000 velocities of m, m, m, m, m, m, ...; expected m1, m2, m3"
    )


def test_published_messages_are_those_of_ros():
    found: Any = TYPE_STORE.deserialize_cdr(messages.wrench(STAMP, 5.0), messages.WRENCH)
    assert (found.header.frame_id, found.wrench.force.z) == ("base", -5.0)
    assert (found.header.stamp.sec, found.header.stamp.nanosec) == (3, 7)
    found = TYPE_STORE.deserialize_cdr(messages.clock(STAMP), messages.CLOCK)
    assert (found.clock.sec, found.clock.nanosec) == (3, 7)
    found = TYPE_STORE.deserialize_cdr(messages.joint_state(STAMP, JOINTS, range(6)), JOINT_STATE)
    assert found.name == list(JOINTS) and found.position.tolist() == [0, 1, 2, 3, 4, 5] and not len(found.effort)
