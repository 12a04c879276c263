"""A run written as a bag of ROS 2, and what others' readers find in it."""

import shutil
from collections.abc import Callable, Iterator, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from validation.masters.robot import PLACE, ROOT
from validation.yardstick import Yardstick

DURATION = 8.0
"""s of Fig. 4: free air, contact and the first of the sweep."""


@cache
def bag() -> tuple[Path, Path]:
    """A recording, and the bag made of it."""
    import twin
    from twin.kernel.recording.export.export import export_recording
    from twin.studies.export import JOINT_FIELDS

    folder = PLACE / "bag"
    shutil.rmtree(folder, ignore_errors=True)
    experiment = twin.load(ROOT / "experiments" / "fig4_force_position.toml", [f"duration_s={DURATION:g}"])
    recording = twin.run(experiment, folder).recording
    return recording, export_recording(recording, "ros2", out=PLACE / "bag_ros2", force=True, joints=JOINT_FIELDS).path


def by_rosbags(folder: Path) -> Iterator[tuple[str, int, Any]]:
    """Topic, time (ns) and message."""
    from rosbags.rosbag2 import Reader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    with Reader(folder) as reader:
        for connection, time, data in reader.messages():
            yield connection.topic, time, store.deserialize_cdr(data, connection.msgtype)


def by_foxglove(folder: Path) -> Iterator[tuple[str, int, Any]]:
    """Topic, time (ns) and message."""
    from mcap.reader import make_reader
    from mcap_ros2.decoder import DecoderFactory

    with next(folder.glob("*.mcap")).open("rb") as file:
        for _, channel, message, decoded in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            yield channel.topic, message.log_time, decoded


def numbers(message: Any) -> list[float]:
    """The numbers of a message that are signals."""
    for path in (("pose", "position"), ("twist", "linear"), ("wrench", "force")):
        if hasattr(message, path[0]):
            vector = getattr(getattr(message, path[0]), path[1])
            return [vector.x, vector.y, vector.z]
    if hasattr(message, "data"):
        return list(message.data)
    return [*message.position, *message.velocity, *message.effort]


def strayed(read: Callable[[Path], Iterator[tuple[str, int, Any]]]) -> Mapping[str, float]:
    """How many numbers of each topic are not, bit for bit, at their time what was recorded."""
    from twin.kernel.recording.export.ros_bag import ros_topics
    from twin.kernel.recording.reader import read as read_recording
    from twin.studies.export import JOINT_FIELDS

    path, folder = bag()
    recording = read_recording(path)
    found: dict[str, tuple[list[int], list[list[float]]]] = {}
    for topic, time, message in read(folder):
        times, rows = found.setdefault(topic, ([], []))
        times.append(time)
        rows.append(numbers(message))
    differences = {}
    for source, stream in recording.streams.items():
        for sent in ros_topics(source, stream.fields, JOINT_FIELDS):
            times, rows = found.get(sent.name, ([], []))
            columns = [
                stream.values[name].astype(float).reshape(len(stream.records), -1)[:, k] for _, name, k in sent.places
            ]
            expected = np.stack(columns, axis=1)
            if np.shape(rows) != expected.shape or times != stream.head["log_time"].tolist():
                differences[sent.name[1:]] = float(expected.size)
            else:
                differences[sent.name[1:]] = float(np.sum(np.array(rows).view(np.uint64) != expected.view(np.uint64)))
    return differences


YARDSTICKS = tuple(
    Yardstick(
        f"{DURATION:g} s of fig4_force_position as a bag of ROS 2: every number and time as it was recorded",
        source,
        "numbers",
        0.0,
        "a double is a double in CDR, and a time whole nanoseconds",
        partial(strayed, read),
        (package,),
    )
    for source, package, read in (
        ("rosbags, Ternaris", "rosbags", by_rosbags),
        ("mcap-ros2-support, Foxglove", "mcap-ros2-support", by_foxglove),
    )
)
