"""Messages of others beside twin's own, as they came."""

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader

from twin.kernel.errors import UnknownSeries
from twin.kernel.recording.messages import Field, Topic
from twin.kernel.recording.reader import read
from twin.kernel.recording.writer import ForeignTopic, Writer

PLANT = Topic("plant", (Field("p_B", 3, "double", "m", "position"),), 1)

MESSAGES = [bytes([k]) * (4 + k % 3) for k in range(50)] + [b""]


def written(path: Path, name: str = "/joint_states") -> Path:
    other = ForeignTopic(name, "cdr", "sensor_msgs/msg/JointState", "ros2msg", b"string[] name")
    with Writer(path, [PLANT], 1e-9, {}, others=[other]) as writer:
        ticks = np.array([0, 10, 11, 500], dtype=np.int64)
        writer.write_messages(name, list(range(0, 510, 10)), MESSAGES)
        writer.write_at("plant", ticks, np.arange(12.0).reshape(4, 3))
        writer.flush()
        writer.write_at("plant", ticks[-1:] + 1, np.zeros((1, 3)))
    return path


def test_they_come_back_byte_for_byte_with_their_type_and_twins_own_beside_them(tmp_path: Path):
    path = written(tmp_path / "run.mcap")
    with path.open("rb") as file:
        found = [(schema, channel, message) for schema, channel, message in make_reader(file).iter_messages()]
    others = [message for _, channel, message in found if channel.topic == "/joint_states"]
    assert [message.data for message in others] == MESSAGES
    assert [message.sequence for message in others] == list(range(51))
    schema = next(schema for schema, channel, _ in found if channel.topic == "/joint_states")
    assert schema is not None
    assert (schema.name, schema.encoding, schema.data) == ("sensor_msgs/msg/JointState", "ros2msg", b"string[] name")
    recording = read(path)
    assert recording.complete
    assert (recording.time("plant") * 1e9).tolist() == pytest.approx([0.0, 10.0, 11.0, 500.0, 501.0])
    assert recording["plant.p_B"][:4].tolist() == np.arange(12.0).reshape(4, 3).tolist()
    with pytest.raises(UnknownSeries):
        recording["joint_states.name"]


def test_a_topic_that_is_called_as_one_of_twins_is_the_robots(tmp_path: Path):
    recording = read(written(tmp_path / "run.mcap", "/plant"))
    assert recording.complete
    with recording.path.open("rb") as file:
        summary = make_reader(file).get_summary()
    assert summary is not None
    assert {channel.topic for channel in summary.channels.values()} == {"/plant", "/robot/plant", "/events"}


def test_ticks_that_do_not_ascend_are_refused(tmp_path: Path):
    with Writer(tmp_path / "run.mcap", [PLANT], 1e-9, {}) as writer:
        writer.write_at("plant", np.array([5]), np.zeros((1, 3)))
        for ticks in ([5], [7, 7], [4, 9]):
            with pytest.raises(ValueError, match="ascend"):
                writer.write_at("plant", np.array(ticks), np.zeros((len(ticks), 3)))


def test_what_was_flushed_is_readable_before_the_recording_is_finished(tmp_path: Path):
    writer = Writer(tmp_path / "run.mcap", [PLANT], 1e-9, {})
    writer.write_at("plant", np.array([5]), np.ones((1, 3)))
    writer.flush()
    assert len(read(tmp_path / "run.mcap.partial")["plant.p_B"]) == 1
    writer.abandon()
