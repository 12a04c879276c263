"""Reading of recordings: finished, unfinished or damaged, with their samples or only their metadata and attachments."""

import os
import struct
from collections.abc import Iterator, KeysView, Mapping
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import numpy as np
from google.protobuf.message import DecodeError
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Attachment, Metadata
from mcap.writer import MCAP0_MAGIC

from twin.kernel.errors import (
    InputRefused,
    RecordingDamageError,
    RecordingError,
    UnknownSeries,
    escape_controls,
    nearest,
    translate_disk_errors,
)
from twin.kernel.files import MAX_TEXT_BYTES, parse_json
from twin.kernel.recording.folder import PARTIAL_SUFFIX, recording_in
from twin.kernel.recording.messages import RECORD_PREFIX, Field, MessageLayout
from twin.kernel.recording.scan import NS_PER_S, Contents, Damage, Event, Scan
from twin.kernel.recording.summary import encode_record

CONTINUES_KEY = "continues"
"""Metadata record of a run that started from a saved state: the original run, and the start time (`time_s`)."""
TIME_ROUNDING = 2
"""Tolerance of sample times (ns); times are rounded to whole nanoseconds."""


@dataclass(frozen=True, repr=False)
class Stream:
    """All messages of one numeric topic: fields in the order of the schema, records (n, layout.stride) uint8."""

    fields: tuple[Field, ...]
    layout: MessageLayout
    records: np.ndarray

    @property
    def head(self) -> np.ndarray:
        """Sequence numbers and times (ns) of the topic's records, structured (n,)."""
        return self.records.view(self.layout.head)[:, 0]

    @property
    def values(self) -> np.ndarray:
        """Numbers of the topic's records, structured (n,), one name per field."""
        return self.records.view(self.layout.values)[:, 0]


@dataclass(frozen=True, repr=False)
class Recording:
    """Contents of a recording: `recording["arm.tip"]`, `recording.time("arm")`.

    Attributes:
        streams: numeric topics by name, without the leading slash.
        metadata: name -> key -> text; records of one name are merged, later keys win.
        complete: whether the file was finished and is undamaged.
        note: why the recording is incomplete and how far it was read; empty if complete.
    """

    path: Path
    streams: dict[str, Stream]
    events: list[Event]
    metadata: dict[str, dict[str, str]]
    complete: bool
    note: str

    def __getitem__(self, key: str) -> np.ndarray:
        """Return the values of series `topic.field`: (n,), or (n, size) for a vector; float64, int64 or bool.

        Raises:
            UnknownSeries: unknown topic or field; the error message suggests the nearest names.
        """
        if key not in self.fields():
            hint = nearest(str(key), self.fields(), "it holds {}", 3)
            raise UnknownSeries(f"{self.path}: no series {key!r}; {hint}", key)
        topic, _, name = key.rpartition(".")
        return np.ascontiguousarray(self.streams[topic].values[name])

    def __contains__(self, key: object) -> bool:
        """Whether the recording has the series `topic.field`."""
        return key in self.fields()

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the recorded series, `topic.field`, in the order of the file."""
        return iter(self.fields())

    def keys(self) -> KeysView[str]:
        """Return the names of the recorded series; makes `dict(recording)` work."""
        return self.fields().keys()

    def time(self, topic: str) -> np.ndarray:
        """Return the simulation times of the messages of `topic`, s, (n,).

        Raises:
            UnknownSeries: unknown topic; the error message suggests the nearest names.
        """
        if topic not in self.streams:
            hint = nearest(topic, self.streams, "it holds {}", 3)
            raise UnknownSeries(f"{self.path}: no topic {topic!r}; {hint}", topic)
        return self.streams[topic].head["log_time"] / NS_PER_S

    @property
    def deviations(self) -> tuple[str, ...]:
        """Reasons why the experiment alone does not reproduce the recorded run, as sentences; empty if it does."""
        stated = [
            f"{name} was substituted by {kind}: the experiment alone does not repeat this run"
            for name, kind in self.metadata.get("substituted", {}).items()
        ]
        if "served" in self.metadata:
            stated.append("a remote controller commanded the drives: the experiment alone does not repeat this run")
        if "changed" in self.metadata:
            stated.append("changed by hand while it ran: the experiment alone does not repeat this run")
        return tuple(escape_controls(text) for text in stated)

    @property
    def other_parts(self) -> tuple[str, ...]:
        """Descriptions of the third-party parts of the robot in the recorded run."""
        return tuple(escape_controls(text) for text in self.metadata.get("part", {}).values())

    def fields(self) -> dict[str, Field]:
        """Return each recorded series `topic.field` -> its field, with unit and meaning, in the order of the file."""
        return {f"{topic}.{f.name}": f for topic, stream in self.streams.items() for f in stream.fields}


def read_metadata(path: Path) -> dict[str, dict[str, str]]:
    """Read the metadata of a recording's file, finished or not: name -> key -> text; else RecordingError.

    Skips samples and checks nothing, unlike `read`.
    """
    found: dict[str, dict[str, str]] = {}
    for body in _record_bodies(path, Opcode.METADATA):
        try:
            record = Metadata.read(ReadDataStream(BytesIO(body)))
        except (McapError, ValueError, struct.error, OverflowError):
            raise RecordingError(f"{path}: not a recording that twin wrote: its metadata is damaged") from None
        found.setdefault(record.name, {}).update(record.metadata)
    return found


def attachments(path: Path, media_type: str) -> Iterator[tuple[float, bytes]]:
    """Yield (simulation time in s, content) of each complete attachment of `media_type` in a recording.

    The file may be unfinished. Skips samples, and attachments that fail their CRC. RecordingError: it cannot be read.
    """
    for body in _record_bodies(path, Opcode.ATTACHMENT):
        try:
            record = Attachment.read(ReadDataStream(BytesIO(body)))
        except (McapError, ValueError, struct.error, OverflowError):
            continue
        if record.media_type == media_type and encode_record(record)[RECORD_PREFIX:] == body:
            yield record.log_time / NS_PER_S, record.data


def _record_bodies(path: Path, opcode: Opcode) -> Iterator[bytes]:
    """Yield the body of each complete MCAP record of type `opcode` outside chunks; raises as `read_metadata`."""
    with translate_disk_errors(path, "cannot be read", RecordingError), path.open("rb") as file:
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise RecordingError(f"{path}: not an MCAP file, expected a recording of twin")
        for kind, length in _records(file):
            if kind == Opcode.DATA_END:
                break
            if kind == opcode and length <= MAX_TEXT_BYTES:
                yield file.read(length)


def _records(file: BinaryIO) -> Iterator[tuple[int, int]]:
    """Yield (opcode, length) of each complete MCAP record after the magic, with `file` at the beginning of its body."""
    size, position = os.fstat(file.fileno()).st_size, len(MCAP0_MAGIC)
    while position + RECORD_PREFIX <= size:
        file.seek(position)
        opcode, length = struct.unpack("<BQ", file.read(RECORD_PREFIX))
        position += RECORD_PREFIX + length
        if position > size:
            break
        yield opcode, length


def read(path: str | Path, *, salvage: bool = False) -> Recording:
    """Read a recording from its file, finished or not.

    An unfinished file is read up to its last complete chunk, and `complete` and `note` of the result report it.

    Args:
        path: `NAME.mcap` or `NAME.mcap.partial`, a run's folder, or results/<experiment> for its latest run.
        salvage: return the data before the damage instead of raising.

    Raises:
        RecordingError: missing, empty, not MCAP or not in the layout of `Writer`.
        RecordingDamageError: bytes have changed since they were written (unless salvage).
    """
    path = Path(path)
    if path.is_dir():
        path = recording_in(path)
    try:
        with path.open("rb") as file:
            return _read_file(path, file, salvage)
    except OSError as error:
        partial = path.with_name(path.name + PARTIAL_SUFFIX)
        hint = f"; an unfinished recording exists: {partial.name}" if partial.exists() else ""
        raise RecordingError(f"{path}: cannot be read: {error.strerror}{hint}") from error
    except (ValueError, LookupError, OverflowError, struct.error, McapError, DecodeError) as error:
        reason = error.args[0] if isinstance(error, LookupError) and error.args else error
        raise RecordingError(f"{path}: not a recording that twin wrote: {reason}") from error


def last_time(path: Path) -> float | None:
    """Read the simulation time (s) of the last message in a complete chunk of `path`; None without a complete chunk.

    The file may be unfinished. Reads only the front of each chunk, where the times of its first and last message are
    (https://mcap.dev/spec#chunk-op0x06), and checks nothing, unlike `read`.
    """
    last = None
    with path.open("rb") as file:
        for opcode, _ in _records(file):
            if opcode == Opcode.CHUNK:
                _, last = struct.unpack("<QQ", file.read(16))
    return None if last is None else last / NS_PER_S


def _read_file(path: Path, file: BinaryIO, salvage: bool) -> Recording:
    magic = file.read(len(MCAP0_MAGIC))
    if magic != MCAP0_MAGIC:
        what = "not an MCAP file" if magic else "an empty file"
        raise RecordingError(f"{path}: {what}, expected a recording of twin")
    contents = Contents()
    metadata: dict[str, dict[str, str]] = {}
    scan = Scan(file)
    damage = None
    try:
        for position, found in scan.contents():
            if isinstance(found, bytes):
                contents.add(position, found)
            else:
                metadata.setdefault(found.name, {}).update(found.metadata)
        if scan.complete:
            stated, there = scan.statistics, sum(contents.counts.values())
            if stated is None:
                raise Damage(scan.position, "its index lacks the message counts")
            counts = {channel: count for channel, count in stated.channel_message_counts.items() if count}
            if counts != contents.counts or stated.message_count != sum(counts.values()):
                raise Damage(scan.position, f"it has {there} messages, its index counts {stated.message_count}")
    except Damage as error:
        damage = error
    if contents.foreign and not contents.series:
        raise RecordingError(f"{path}: not a recording that twin wrote: it has no topic of twin")
    streams = {
        contents.topics[channel]: Stream(series.fields, series.layout, series.all_records())
        for channel, series in contents.series.items()
    }
    note = ""
    if damage is not None:
        what = f"damaged at byte {damage.position}: {damage.reason}"
        if not salvage:
            raise RecordingDamageError(f"{path}: {what}; with salvage it can be read {_reach_text(streams)}")
        note = f"{what}; read {_reach_text(streams)}"
    elif not scan.complete:
        note = f"unfinished recording: read {_reach_text(streams)}; {scan.rest} bytes after that are incomplete"
    else:
        note = _shortfall(streams, metadata)
    return Recording(path, streams, contents.events, metadata, not note, note)


def _reach_text(streams: dict[str, Stream]) -> str:
    ends = [stream.head["log_time"][-1] for stream in streams.values() if len(stream.records)]
    if not ends:
        return "up to its metadata, no chunk is complete"
    return f"up to {max(ends) / NS_PER_S:.3f} s, its last complete chunk"


def _shortfall(streams: Mapping[str, Stream], metadata: Mapping[str, Mapping[str, str]]) -> str:
    """Describe the samples that a recording lacks; "" if it is complete or its intended duration is unknown.

    Chunks can be removed from a file and the rest resealed, index included. Missing samples remain detectable because a
    run is recorded tick by tick, from 0 to the duration of its experiment.
    """
    duration, began = _duration(metadata), _start_time(metadata)
    # a remote controller sends when it likes, and may end a run
    served = metadata.get("served", {})
    irregular = served.get("irregular", "").split()
    times = {name: one.head["log_time"].astype(np.int64) for name, one in streams.items() if name not in irregular}
    if duration is None or not any(len(t) for t in times.values()):
        return ""
    end = max(int(t[-1]) for t in times.values() if len(t))
    for topic, t in times.items():
        steps = np.diff(t)
        # every step is the topic's period; the last sample is less than one period before the end
        period = int(np.median(steps)) if len(steps) else 0
        # a run restored from a state begins at the time of that state
        if not len(t) or t[0] > (began + period - 1 if began else 0) + TIME_ROUNDING:
            return f"the first samples of {topic} are missing"
        uneven = np.flatnonzero(np.abs(steps - period) > TIME_ROUNDING)
        if len(uneven):
            at = uneven[0]
            return (
                f"samples of {topic} are missing or moved: after {t[at] / NS_PER_S:.3f} s comes "
                f"{t[at + 1] / NS_PER_S:.3f} s, though one is due every {period / NS_PER_S:g} s"
            )
        if len(steps) and end - t[-1] >= period - TIME_ROUNDING:
            return f"samples of {topic} are missing: the last is at {t[-1] / NS_PER_S:.3f} s"
    # a duration is a whole number of ticks to a billionth
    if not served and abs(end - duration * NS_PER_S) > TIME_ROUNDING + duration:
        return f"ends at {end / NS_PER_S:.3f} s, though its experiment lasts {duration:g} s"
    return ""


def _start_time(metadata: Mapping[str, Mapping[str, str]]) -> int:
    """Return the start time (ns) of a recorded run that began from another run's state; 0 for any other run."""
    try:
        return max(0, round(float(metadata[CONTINUES_KEY]["time_s"]) * NS_PER_S))
    except (KeyError, ValueError, OverflowError):
        return 0


def _duration(metadata: Mapping[str, Mapping[str, str]]) -> float | None:
    """Return the intended duration of a recorded run (s) by its experiment; None if it is missing or invalid."""
    try:
        values = parse_json(metadata["experiment"]["values"], "")
        duration = float(values["duration_s"])
    except (InputRefused, KeyError, TypeError, ValueError, OverflowError):
        return None
    return duration if 0.0 < duration < 1e9 else None
