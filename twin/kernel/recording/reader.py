"""Recordings read back: whole, unfinished or damaged.

What a recording says of its origin, read without its samples.
"""

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


@dataclass(frozen=True, repr=False)
class Stream:
    """All messages of one numeric topic.

    Attributes:
        fields: in the order of the file's schema.
        layout: of one record.
        records: (n, layout.stride) uint8.
    """

    fields: tuple[Field, ...]
    layout: MessageLayout
    records: np.ndarray

    @property
    def head(self) -> np.ndarray:
        """Sequence numbers and times (ns) of the records, structured (n,)."""
        return self.records.view(self.layout.head)[:, 0]

    @property
    def values(self) -> np.ndarray:
        """Numbers of the records, structured (n,), one name per field."""
        return self.records.view(self.layout.values)[:, 0]


@dataclass(frozen=True, repr=False)
class Recording:
    """What a file holds: `recording["arm.tip"]`, `recording.time("arm")`.

    Attributes:
        path: of the file.
        streams: numeric topics by name, without the leading slash.
        events: in the order of the file.
        metadata: name -> key -> text; records of one name are joined, later keys win.
        complete: whether the file was finished and is undamaged.
        note: one sentence that says why not and how far it was read; empty if complete.
    """

    path: Path
    streams: dict[str, Stream]
    events: list[Event]
    metadata: dict[str, dict[str, str]]
    complete: bool
    note: str

    def __getitem__(self, key: str) -> np.ndarray:
        """Values of `topic.field`: (n,) or, for a field of several values, (n, size); float64, int64 or bool.

        Raises:
            UnknownSeries: no such topic or field; it names the nearest ones.
        """
        if key not in self.fields():
            hint = nearest(str(key), self.fields(), "it holds {}", 3)
            raise UnknownSeries(f"{self.path}: no series {key!r}; {hint}", key)
        topic, _, name = key.rpartition(".")
        return np.ascontiguousarray(self.streams[topic].values[name])

    def __contains__(self, key: object) -> bool:
        """Whether there is a series `topic.field`."""
        return key in self.fields()

    def __iter__(self) -> Iterator[str]:
        """Names of the series, `topic.field`, in the order of the file."""
        return iter(self.fields())

    def keys(self) -> KeysView[str]:
        """Names of the series, so that `dict(recording)` has the values of all."""
        return self.fields().keys()

    def time(self, topic: str) -> np.ndarray:
        """Simulation times of the messages of `topic`, s, (n,).

        Raises:
            UnknownSeries: no such topic; it names the nearest ones.
        """
        if topic not in self.streams:
            raise UnknownSeries(
                f"{self.path}: no topic {topic!r}; {nearest(topic, self.streams, 'it holds {}', 3)}", topic
            )
        return self.streams[topic].head["log_time"] / NS_PER_S

    @property
    def deviations(self) -> tuple[str, ...]:
        """Sentences on what makes this run another one than that of its experiment alone; empty if nothing does."""
        stated = [
            f"{name} was substituted by {kind}: the experiment alone does not repeat this run"
            for name, kind in self.metadata.get("substituted", {}).items()
        ]
        if "changed" in self.metadata:
            stated.append("changed by hand while it ran: the experiment alone does not repeat this run")
        return tuple(escape_controls(text) for text in stated)

    @property
    def other_parts(self) -> tuple[str, ...]:
        """Sentences on third-party parts of the robot."""
        return tuple(escape_controls(text) for text in self.metadata.get("part", {}).values())

    def fields(self) -> dict[str, Field]:
        """`topic.field` -> the field with its unit and meaning, in the order of the file."""
        return {f"{topic}.{f.name}": f for topic, stream in self.streams.items() for f in stream.fields}


def read_metadata(path: Path) -> dict[str, dict[str, str]]:
    """The metadata of the recording's file `path`, finished or not: name -> key -> text.

    Goes from record to record; samples are passed over. Nothing is checked: `reader.read` does that.

    Raises:
        RecordingRefused: it cannot be read, or is no MCAP file.
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
    """(simulation time in s, content) of each whole attachment of that type in the recording's file, finished or not.

    Goes from record to record; samples are passed over. What an attachment's own CRC refuses is passed over, too.

    Raises:
        RecordingRefused: it cannot be read, or is no MCAP file.
    """
    for body in _record_bodies(path, Opcode.ATTACHMENT):
        try:
            record = Attachment.read(ReadDataStream(BytesIO(body)))
        except (McapError, ValueError, struct.error, OverflowError):
            continue
        if record.media_type == media_type and encode_record(record)[RECORD_PREFIX:] == body:
            yield record.log_time / NS_PER_S, record.data


def _record_bodies(path: Path, opcode: Opcode) -> Iterator[bytes]:
    """Of each whole record of that kind outside chunks; raises as `read_metadata`."""
    with translate_disk_errors(path, "cannot be read", RecordingError), path.open("rb") as file:
        if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            raise RecordingError(f"{path}: not an MCAP file, expected a recording of twin")
        for kind, length in _records(file):
            if kind == Opcode.DATA_END:
                break
            if kind == opcode and length <= MAX_TEXT_BYTES:
                yield file.read(length)


def _records(file: BinaryIO) -> Iterator[tuple[int, int]]:
    """(opcode, length) of each complete record after the magic of a `file`, which stands behind both then."""
    size, position = os.fstat(file.fileno()).st_size, len(MCAP0_MAGIC)
    while position + RECORD_PREFIX <= size:
        file.seek(position)
        opcode, length = struct.unpack("<BQ", file.read(RECORD_PREFIX))
        position += RECORD_PREFIX + length
        if position > size:
            break
        yield opcode, length


CONTINUES_KEY = "continues"
"""Metadata of a recording that goes on from the state of a run: which run, and from when on (`time_s`)."""
TIME_ROUNDING = 2
"""ns; times are rounded to whole ones."""


def read(path: str | Path, *, salvage: bool = False) -> Recording:
    """The recording in `path`, finished or not.

    An unfinished file is read up to its last complete chunk; `complete` and `note` of the result say so.

    Args:
        path: `NAME.mcap` or `NAME.mcap.partial`, a run's folder, or results/<experiment>: its latest run.
        salvage: return what precedes damage instead of raising.

    Raises:
        RecordingRefused: missing, empty, not MCAP or not of the layout that `Writer` gives.
        RecordingDamaged: bytes have changed since they were written (unless salvage).
    """
    path = Path(path)
    if path.is_dir():
        path = recording_in(path)
    try:
        with path.open("rb") as file:
            return _read_file(path, file, salvage)
    except OSError as error:
        partial = path.with_name(path.name + PARTIAL_SUFFIX)
        hint = f"; an unfinished recording is beside it: {partial.name}" if partial.exists() else ""
        raise RecordingError(f"{path}: cannot be read: {error.strerror}{hint}") from error
    except (ValueError, LookupError, OverflowError, struct.error, McapError, DecodeError) as error:
        reason = error.args[0] if isinstance(error, LookupError) and error.args else error
        raise RecordingError(f"{path}: not a recording that twin wrote: {reason}") from error


def last_time(path: Path) -> float | None:
    """Simulation time (s) of the last message in a complete chunk of `path`, finished or not; None if it has no chunk.

    Goes from record to record; a chunk starts with the times of its first and last message
    (https://mcap.dev/spec#chunk-op0x06). Nothing is checked: `reader.read` does that.
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
                raise Damage(scan.position, "its index does not say how many messages there are")
            counts = {channel: count for channel, count in stated.channel_message_counts.items() if count}
            if counts != contents.counts or stated.message_count != sum(counts.values()):
                raise Damage(scan.position, f"{there} messages are there where its index counts {stated.message_count}")
    except Damage as error:
        damage = error
    if contents.foreign and not contents.series:
        raise RecordingError(f"{path}: not a recording that twin wrote: none of its topics is one of twin's")
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
    """How far the messages of `streams` reach, as half a sentence."""
    ends = [stream.head["log_time"][-1] for stream in streams.values() if len(stream.records)]
    if not ends:
        return "up to its metadata, no chunk is complete"
    return f"up to {max(ends) / NS_PER_S:.3f} s, its last complete chunk"


def _shortfall(streams: Mapping[str, Stream], metadata: Mapping[str, Mapping[str, str]]) -> str:
    """One sentence on what is missing of the run; "" if nothing is, or if it does not say how long it was to be.

    Chunks can be taken out of a file and the rest be sealed again, index and all. What then still tells is that a run
    is recorded tick by tick, from 0 to the duration of its experiment.
    """
    duration, began = _duration(metadata), _start_time(metadata)
    times = {topic: stream.head["log_time"].astype(np.int64) for topic, stream in streams.items()}
    if duration is None or not any(len(t) for t in times.values()):
        return ""
    end = max(int(t[-1]) for t in times.values() if len(t))
    for topic, t in times.items():
        steps = np.diff(t)
        # every step is the topic's period; the last sample is less than one before the end
        period = int(np.median(steps)) if len(steps) else 0
        # what goes on from a state begins where that was taken
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
    if abs(end - duration * NS_PER_S) > TIME_ROUNDING + duration:
        return f"ends at {end / NS_PER_S:.3f} s, though its experiment lasts {duration:g} s"
    return ""


def _start_time(metadata: Mapping[str, Mapping[str, str]]) -> int:
    """When a run begins that goes on from another one's state (ns); 0: it does not."""
    try:
        return max(0, round(float(metadata[CONTINUES_KEY]["time_s"]) * NS_PER_S))
    except (KeyError, ValueError, OverflowError):
        return 0


def _duration(metadata: Mapping[str, Mapping[str, str]]) -> float | None:
    """Of the run (s), as its experiment says; None: it does not."""
    try:
        values = parse_json(metadata["experiment"]["values"], "")
        duration = float(values["duration_s"])
    except (InputRefused, KeyError, TypeError, ValueError, OverflowError):
        return None
    return duration if 0.0 < duration < 1e9 else None
