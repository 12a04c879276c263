"""A recording as a bag of ROS 2: MCAP with CDR, metadata.yaml, and the column map that reads it back."""

import json
import os
import shutil
import tempfile
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import zstandard
from mcap.records import Channel, Header, Metadata, MetadataIndex, Schema
from mcap.writer import MCAP0_MAGIC

from twin import __version__
from twin.errors import InputRefused, disk_refusals
from twin.recording.chunks import COMPRESSION_LEVEL, encoded
from twin.recording.export.ros_layout import RosTopic, definition, ros_topics
from twin.recording.export.table import NANOSECONDS, message_times, numbers_of, row_times, topics_of
from twin.recording.filling import NO_PLACES, Filling
from twin.recording.messages import HEAD_SIZE, record_template
from twin.recording.output import Output
from twin.recording.pending import Pending
from twin.recording.recording import Recording
from twin.recording.summary import Summary
from twin.recording.writer import append_chunks
from twin.writing import made_folder, write_text

METADATA, MAP = "metadata.yaml", "map.toml"
AT_ONCE = 10_000
"""Messages of a topic that are in memory as records."""


def write_ros_bag(folder: Path, recording: Recording, signals: Sequence[str], rate: float | None = None) -> int:
    """Write `signals` to the folder `folder`, in the place of a bag of ours if one is there; how many messages.

    Log times and stamps are simulation time.

    Args:
        signals: names `topic.field`, each with at least one message.
        rate: messages per second and topic (Hz), see `table.table`; without one, every topic keeps its own times.

    Raises:
        InputRefused: a rate that `table` refuses, something else in the way.
        NotWritten: it cannot be written.
    """
    own = {f"{folder.name}_0.mcap", METADATA, MAP}
    if os.path.lexists(folder) and not (folder.is_dir() and set(os.listdir(folder)) <= own):
        raise InputRefused(f"{folder}: already there and no bag of twin; name another with --out")
    fields = recording.fields()
    times = {topic: message_times(recording, topic) for topic in topics_of(signals)}
    common = row_times(list(times.values()), rate, numbers_of(recording, signals))
    topics = [
        made
        for topic in times
        for made in ros_topics(topic, [fields[name] for name in signals if name.rpartition(".")[0] == topic])
    ]
    made_folder(folder.parent)
    with disk_refusals(folder):
        beside = Path(tempfile.mkdtemp(prefix=f".{folder.name[:60]}.", dir=folder.parent))
        try:
            rows = {topic: own if rate is None else common for topic, own in times.items()}
            counts = _write_file(beside / f"{folder.name}_0.mcap", recording, topics, times, rows)
            write_text(beside / METADATA, _metadata(f"{folder.name}_0.mcap", topics, counts, list(rows.values())))
            write_text(beside / MAP, _map(topics))
            # as readable as any folder; mkdtemp makes it the owner's alone
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
    """The MCAP file of the bag; how many messages each topic has."""
    kinds = list(dict.fromkeys(topic.kind for topic in topics))
    schemas = [Schema(k, definition(kind).encode(), "ros2msg", kind) for k, kind in enumerate(kinds, start=1)]
    qos = {"offered_qos_profiles": ""}
    channels = [Channel(k, t.name, "cdr", qos, kinds.index(t.kind) + 1) for k, t in enumerate(topics, start=1)]
    summary = Summary(schemas, channels)
    output = Output(path)
    # its library is not twin's alone: `written_by_twin` means recordings
    output.append(MCAP0_MAGIC + encoded(Header(profile="ros2", library=f"ros2 export of twin {__version__}")))
    for name, entries in recording.metadata.items():
        record = encoded(Metadata(name, dict(entries)))
        summary.metadata.append(MetadataIndex(output.append(record), len(record), name))
    pending, compressor = Pending(), zstandard.ZstdCompressor(level=COMPRESSION_LEVEL)
    end = max(int(t[-1]) for t in rows.values())
    densest = max(len(t) for t in rows.values())
    # slices of equal length in time, so that no topic runs ahead of another
    edges = np.linspace(0, end + 1, -(-densest // AT_ONCE) + 1).astype(np.int64)
    for start, stop in pairwise(edges.tolist()):
        for channel, topic in zip(channels, topics, strict=True):
            own = rows[topic.source]
            at = own[np.searchsorted(own, start) : np.searchsorted(own, stop)]
            if not len(at):
                continue
            picked = np.searchsorted(times[topic.source], at, side="right") - 1
            records = _records(channel.id, topic, recording, at, picked, summary.message_counts[channel.id])
            summary.message_counts[channel.id] += len(at)
            pending.put(channel.id, at, records)
        append_chunks(output, summary, pending, compressor)
    output.append(summary.ending(output.size, output.crc))
    output.publish()
    return [summary.message_counts[channel.id] for channel in channels]


def _records(
    channel: int, topic: RosTopic, recording: Recording, times: np.ndarray, picked: np.ndarray, first: int
) -> np.ndarray:
    """MCAP records of the messages of `topic` at `times` (ns) with the rows `picked` of the recording."""
    template = record_template(channel, topic.body)
    # its numbers are put in below: they come of several topics
    records = Filling(template, NO_PLACES).records(times, first, np.empty((len(times), 0)))
    assert records is not None, "there are no integers"
    if topic.stamp:
        stamp = np.stack([times // NANOSECONDS, times % NANOSECONDS], axis=1).astype("<u4")
        at = HEAD_SIZE + topic.stamp
        records[:, at : at + 8] = stamp.view(np.uint8)
    values = recording.streams[topic.source].values
    for offset, name, element in topic.places:
        column = values[name][picked].astype("<f8").reshape(len(times), -1)[:, element]
        at = HEAD_SIZE + offset
        records[:, at : at + 8] = np.ascontiguousarray(column).view(np.uint8).reshape(-1, 8)
    return records


def _metadata(file: str, topics: Sequence[RosTopic], counts: Sequence[int], times: Sequence[np.ndarray]) -> str:
    """What rosbag2 wants to know of a bag (version 5, which Humble and all after it read)."""
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
    """The column map by which twin reads the bag."""
    lines = ["# which message of this bag is which signal: twin compare RUN BAG --map map.toml"]
    for topic in topics:
        for signal, (column, unit) in topic.columns.items():
            lines.append(f'"{signal}" = {{ column = "{column}", unit = "{unit}" }}')
    return "\n".join(lines) + "\n"
