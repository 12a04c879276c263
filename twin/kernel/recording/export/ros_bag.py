"""Export of a recording to a ROS 2 bag: MCAP with messages of the ROS packages, metadata.yaml and a column map."""

import json
import os
import shutil
import struct
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
import zstandard
from mcap.records import Channel, Header, Metadata, MetadataIndex, Schema
from mcap.writer import MCAP0_MAGIC

from twin import __version__
from twin.kernel.atomic_write import inline_table, make_folder, write_text
from twin.kernel.errors import InputRefused, translate_disk_errors
from twin.kernel.recording import messages
from twin.kernel.recording.export.table import time_base
from twin.kernel.recording.folder import Output
from twin.kernel.recording.reader import Recording
from twin.kernel.recording.scan import NS_PER_S
from twin.kernel.recording.summary import COMPRESSION_LEVEL, Summary, encode_record
from twin.kernel.recording.writer import PendingMessages, append_chunks

JointFields = Mapping[str, tuple[str, str]]
"""Field of a recording -> the side and kind of its joint values, such as `("motor", "velocity")`, for JointState."""
JOINT_FIELDS = ("position", "velocity", "effort")
_TYPE_DEFINITIONS = {
    "sensor_msgs/msg/JointState": (
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort"
    ),
    "geometry_msgs/msg/WrenchStamped": "std_msgs/Header header\ngeometry_msgs/Wrench wrench",
    "geometry_msgs/msg/TwistStamped": "std_msgs/Header header\ngeometry_msgs/Twist twist",
    "geometry_msgs/msg/PoseStamped": "std_msgs/Header header\ngeometry_msgs/Pose pose",
    "std_msgs/msg/Float64MultiArray": "std_msgs/MultiArrayLayout layout\nfloat64[] data",
    "std_msgs/Header": "builtin_interfaces/Time stamp\nstring frame_id",
    "builtin_interfaces/Time": "int32 sec\nuint32 nanosec",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
    "geometry_msgs/Twist": "geometry_msgs/Vector3 linear\ngeometry_msgs/Vector3 angular",
    "geometry_msgs/Vector3": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Point": "float64 x\nfloat64 y\nfloat64 z",
    "geometry_msgs/Quaternion": "float64 x\nfloat64 y\nfloat64 z\nfloat64 w",
    "std_msgs/MultiArrayLayout": "std_msgs/MultiArrayDimension[] dim\nuint32 data_offset",
    "std_msgs/MultiArrayDimension": "string label\nuint32 size\nuint32 stride",
}
# unit of a vector of three -> message type, path of the vector, and the numbers after it
_VECTOR_MESSAGES = {
    "N": ("geometry_msgs/msg/WrenchStamped", "wrench.force", (0.0, 0.0, 0.0)),
    "m/s": ("geometry_msgs/msg/TwistStamped", "twist.linear", (0.0, 0.0, 0.0)),
    # with the unit quaternion
    "m": ("geometry_msgs/msg/PoseStamped", "pose.position", (0.0, 0.0, 0.0, 1.0)),
}
METADATA_FILE, MAP_FILE = "metadata.yaml", "map.toml"
MAX_BLOCK_MESSAGES = 10_000
"""Maximum number of messages of a topic that are in memory as records."""


@dataclass
class RosTopic:
    """A topic of the ROS 2 bag to be written, `/arm/tip`, made of the topic `source` of the recording.

    `body` is one message as CDR with zeros for numbers and times. `places` are (offset in it, field, element) of each
    number. `stamp` is the offset of seconds and nanoseconds, 0 if the type has none. `columns`: element `arm.tip[0]` ->
    its column `/arm/tip.pose.position.x` and its unit.
    """

    name: str
    kind: str
    source: str
    body: bytes = b""
    places: list[tuple[int, str, int]] = field(default_factory=list)
    stamp: int = 0
    columns: dict[str, tuple[str, str]] = field(default_factory=dict)


def type_definition(kind: str) -> str:
    """Return the definition of a ROS message type with all types it refers to, in MCAP's ros2msg encoding."""
    others = (f"\n{'=' * 80}\nMSG: {name}\n{_TYPE_DEFINITIONS[name]}" for name in dict.fromkeys(_inner_types(kind)))
    return f"{_TYPE_DEFINITIONS[kind]}{''.join(others)}\n"


def _inner_types(kind: str) -> Iterator[str]:
    """Yield the types of a ROS message's fields, each before the types of its own fields."""
    for line in _TYPE_DEFINITIONS[kind].splitlines():
        inner = line.partition(" ")[0].removesuffix("[]")
        if inner in _TYPE_DEFINITIONS:
            yield inner
            yield from _inner_types(inner)


def ros_topics(topic: str, fields: Sequence[messages.Field], joints: JointFields) -> Iterator[RosTopic]:
    """Yield the topics of a ROS 2 bag that carry `fields` of the recording's `topic`."""
    states: dict[str, dict[str, messages.Field]] = {}
    for one in fields:
        side, part = joints.get(one.name, ("", ""))
        same = states.get(side, {})
        if side and len(_joints(topic, side, one)) and all(one.size == other.size for other in same.values()):
            states.setdefault(side, {})[part] = one
        elif one.size == len("xyz") and one.unit in _VECTOR_MESSAGES:
            yield _vector(topic, one)
        else:
            yield _numbers(topic, one)
    for side, parts in states.items():
        yield _joint_state(topic, side, parts)


def _joints(topic: str, side: str, one: messages.Field) -> list[str]:
    """Return the joint names of a recorded field: `joint_1` .. `joint_3`; `motor_2` for the topic `drive/2`."""
    own = topic.rpartition("/")[2]
    if one.size == 1 and own.isdigit():
        return [f"{side}_{own}"]
    return [f"{side}_{k + 1}" for k in range(one.size)] if one.size > 1 else []


def _joint_state(topic: str, side: str, parts: dict[str, messages.Field]) -> RosTopic:
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
    return cdr.finish()


def _vector(topic: str, one: messages.Field) -> RosTopic:
    kind, path, rest = _VECTOR_MESSAGES[one.unit]
    cdr = _Cdr(RosTopic(f"/{topic}/{one.name}", kind, topic))
    cdr.header("B" if one.name.endswith("_B") else "")
    cdr.elements(one, [f"{path}.{axis}" for axis in "xyz"])
    cdr.constants(rest)
    return cdr.finish()


def _numbers(topic: str, one: messages.Field) -> RosTopic:
    cdr = _Cdr(RosTopic(f"/{topic}/{one.name}", "std_msgs/msg/Float64MultiArray", topic))
    cdr.count(1)
    cdr.text(f"{topic}.{one.name} [{one.unit}]")
    # size and stride of the only dimension, offset of its data, and how many follow
    for number in (one.size, one.size, 0, one.size):
        cdr.count(number)
    cdr.elements(one, [f"data[{k}]" for k in range(one.size)])
    return cdr.finish()


class _Cdr:
    """A ROS message in CDR encoding under construction, little endian; numbers are aligned, counted after the head."""

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

    def elements(self, one: messages.Field, paths: Sequence[str]) -> None:
        """Append zeros for the numbers of a field to the ROS message, and note their places and columns."""
        self._align(8)
        for k, path in enumerate(paths):
            self._topic.places.append((len(self._head) + len(self._body), one.name, k))
            signal = f"{self._topic.source}.{one.name}" + (f"[{k}]" if one.size > 1 else "")
            self._topic.columns[signal] = (f"{self._topic.name}.{path}", one.unit)
            self._body += bytes(8)

    def constants(self, numbers: Sequence[float]) -> None:
        self._body += struct.pack(f"<{len(numbers)}d", *numbers)

    def finish(self) -> RosTopic:
        self._topic.body = self._head + bytes(self._body)
        return self._topic

    def _align(self, size: int) -> None:
        self._body += bytes(-len(self._body) % size)


def write_ros_bag(
    folder: Path, recording: Recording, signals: Sequence[str], rate: float | None, joints: JointFields
) -> int:
    """Write `signals` (`topic.field`, with messages) as a ROS 2 bag to `folder`; return the number of messages.

    Log times and stamps are simulation time. `rate` is in messages per second and topic (Hz), see `signal_table`; None
    keeps every topic's own times. `joints` are written as JointState.
    """
    own = {f"{folder.name}_0.mcap", METADATA_FILE, MAP_FILE}
    if os.path.lexists(folder) and not (folder.is_dir() and set(os.listdir(folder)) <= own):
        raise InputRefused(f"{folder}: exists and is not a bag written by twin; name another with --out")
    fields = recording.fields()
    times, common = time_base(recording, signals, rate)
    topics = [
        made
        for topic in times
        for made in ros_topics(topic, [fields[name] for name in signals if name.rpartition(".")[0] == topic], joints)
    ]
    make_folder(folder.parent)
    with translate_disk_errors(folder):
        beside = Path(tempfile.mkdtemp(prefix=f".{folder.name[:60]}.", dir=folder.parent))
        try:
            rows = {topic: own if rate is None else common for topic, own in times.items()}
            counts = _write_file(beside / f"{folder.name}_0.mcap", recording, topics, times, rows)
            write_text(beside / METADATA_FILE, _metadata(f"{folder.name}_0.mcap", topics, counts, list(rows.values())))
            write_text(beside / MAP_FILE, _map(topics))
            # mkdtemp restricts access to the owner; use the usual permissions
            beside.chmod(0o755)
            if os.path.lexists(folder):
                shutil.rmtree(folder)
            beside.rename(folder)
        finally:
            shutil.rmtree(beside, ignore_errors=True)
    return sum(counts)


def _write_file(
    path: Path,
    recording: Recording,
    topics: Sequence[RosTopic],
    times: dict[str, np.ndarray],
    rows: dict[str, np.ndarray],
) -> list[int]:
    """Write the MCAP file of a ROS 2 bag; return the number of messages of each topic."""
    kinds = list(dict.fromkeys(topic.kind for topic in topics))
    schemas = [Schema(k, type_definition(kind).encode(), "ros2msg", kind) for k, kind in enumerate(kinds, start=1)]
    qos = {"offered_qos_profiles": ""}
    channels = [Channel(k, t.name, "cdr", qos, kinds.index(t.kind) + 1) for k, t in enumerate(topics, start=1)]
    summary = Summary(schemas, channels)
    output = Output(path)
    # not "twin" alone: `written_by_twin` recognises recordings by the library
    output.append(MCAP0_MAGIC + encode_record(Header(profile="ros2", library=f"ros2 export of twin {__version__}")))
    for name, entries in recording.metadata.items():
        record = encode_record(Metadata(name, dict(entries)))
        summary.metadata.append(MetadataIndex(output.append(record), len(record), name))
    pending, compressor = PendingMessages(), zstandard.ZstdCompressor(level=COMPRESSION_LEVEL)
    end = max(int(t[-1]) for t in rows.values())
    densest = max(len(t) for t in rows.values())
    # slices of equal duration, so that topics stay interleaved in time
    edges = np.linspace(0, end + 1, -(-densest // MAX_BLOCK_MESSAGES) + 1).astype(np.int64)
    for start, stop in pairwise(edges.tolist()):
        for channel, topic in zip(channels, topics, strict=True):
            own = rows[topic.source]
            at = own[np.searchsorted(own, start) : np.searchsorted(own, stop)]
            if not len(at):
                continue
            picked = np.searchsorted(times[topic.source], at, side="right") - 1
            records = _records(channel.id, topic, recording, at, picked, summary.message_counts[channel.id])
            summary.message_counts[channel.id] += len(at)
            pending.append_records(channel.id, at, records)
        append_chunks(output, summary, pending, compressor)
    output.append(summary.ending(output.size, output.crc))
    output.publish()
    return [summary.message_counts[channel.id] for channel in channels]


def _records(
    channel: int, topic: RosTopic, recording: Recording, times: np.ndarray, picked: np.ndarray, first: int
) -> np.ndarray:
    """Encode messages of a bag's `topic` at `times` (ns), from rows `picked` of the recording, as MCAP records."""
    template = messages.record_template(channel, topic.body)
    # the numbers are copied below: they come from structured columns, not from rows
    records = messages.Filling(template, messages.NO_PLACES).records(times, first, np.empty((len(times), 0)))
    if topic.stamp:
        stamp = np.stack([times // NS_PER_S, times % NS_PER_S], axis=1).astype("<u4")
        at = messages.HEAD_SIZE + topic.stamp
        records[:, at : at + 8] = stamp.view(np.uint8)
    values = recording.streams[topic.source].values
    for offset, name, element in topic.places:
        column = values[name][picked].astype("<f8").reshape(len(times), -1)[:, element]
        at = messages.HEAD_SIZE + offset
        records[:, at : at + 8] = np.ascontiguousarray(column).view(np.uint8).reshape(-1, 8)
    return records


def _metadata(file: str, topics: Sequence[RosTopic], counts: Sequence[int], times: Sequence[np.ndarray]) -> str:
    """Return the metadata.yaml of a ROS 2 bag, for rosbag2 (version 5, read by Humble and later)."""
    start, end = min(int(t[0]) for t in times), max(int(t[-1]) for t in times)
    span = (
        f"duration:\n{{0}}  nanoseconds: {end - start}\n{{0}}starting_time:\n{{0}}  nanoseconds_since_epoch: {start}\n"
    )
    listed = "".join(
        f"    - topic_metadata:\n        name: {topic.name}\n        type: {topic.kind}\n"
        f"        serialization_format: cdr\n        offered_qos_profiles: ''\n      message_count: {count}\n"
        for topic, count in zip(topics, counts, strict=True)
    )
    return (
        f"rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  {span.format('  ')}"
        f"  message_count: {sum(counts)}\n  topics_with_message_count:\n{listed}"
        f"  compression_format: ''\n  compression_mode: ''\n  relative_file_paths:\n    - {json.dumps(file)}\n"
        f"  files:\n    - path: {json.dumps(file)}\n      {span.format('      ')}      message_count: {sum(counts)}\n"
    )


def _map(topics: Sequence[RosTopic]) -> str:
    # imported here because other formats do not need it
    import tomlkit

    rows = {
        signal: inline_table({"column": column, "unit": unit})
        for topic in topics
        for signal, (column, unit) in topic.columns.items()
    }
    return "# which message of this bag is which signal: twin compare RUN BAG --map map.toml\n" + tomlkit.dumps(rows)
