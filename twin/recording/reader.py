"""Reading a file that `Writer` wrote, whole, unfinished or damaged."""

import struct
from pathlib import Path
from typing import BinaryIO

from google.protobuf.message import DecodeError
from mcap.exceptions import McapError
from mcap.writer import MCAP0_MAGIC

from twin.recording.errors import RecordingDamaged, RecordingRefused
from twin.recording.folder import recording_in
from twin.recording.output import PARTIAL
from twin.recording.recording import Recording, Stream
from twin.recording.scan import Damage, Scan
from twin.recording.series import NANOSECONDS, Contents
from twin.recording.shortfall import shortfall


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
            return _read(path, file, salvage)
    except OSError as error:
        partial = path.with_name(path.name + PARTIAL)
        hint = f"; an unfinished recording is beside it: {partial.name}" if partial.exists() else ""
        raise RecordingRefused(f"{path}: cannot be read: {error.strerror}{hint}") from error
    except (ValueError, LookupError, OverflowError, struct.error, McapError, DecodeError) as error:
        raise RecordingRefused(f"{path}: not a recording that twin wrote: {_told(error)}") from error


def _read(path: Path, file: BinaryIO, salvage: bool) -> Recording:
    magic = file.read(len(MCAP0_MAGIC))
    if magic != MCAP0_MAGIC:
        what = "not an MCAP file" if magic else "an empty file"
        raise RecordingRefused(f"{path}: {what}, expected a recording of twin")
    contents = Contents()
    metadata: dict[str, dict[str, str]] = {}
    scan = Scan(file)
    damage = None
    try:
        for found in scan.contents():
            if isinstance(found.value, bytes):
                contents.add(found.position, found.value)
            else:
                metadata.setdefault(found.value.name, {}).update(found.value.metadata)
        if scan.complete:
            _compare(scan, contents)
    except Damage as error:
        damage = error
    if contents.passed and not contents.series:
        raise RecordingRefused(f"{path}: not a recording that twin wrote: none of its topics is one of twin's")
    streams = {
        contents.topics[channel]: Stream(series.fields, series.layout, series.all_records())
        for channel, series in contents.series.items()
    }
    note = ""
    if damage is not None:
        what = f"damaged at byte {damage.position}: {damage.reason}"
        if not salvage:
            raise RecordingDamaged(f"{path}: {what}; with salvage it can be read {_reach(streams)}")
        note = f"{what}; read {_reach(streams)}"
    elif not scan.complete:
        note = f"unfinished recording: read {_reach(streams)}; {scan.rest} bytes after that are incomplete"
    else:
        note = shortfall(streams, metadata)
    return Recording(path, streams, contents.events, metadata, not note, note)


def _told(error: Exception) -> str:
    return str(error.args[0]) if isinstance(error, LookupError) and error.args else str(error)


def _compare(scan: Scan, contents: Contents) -> None:
    """Raise Damage if what is there is not what the index says was written."""
    said = scan.statistics
    if said is None:
        raise Damage(scan.position, "its index does not say how many messages there are")
    counts = {channel: count for channel, count in said.channel_message_counts.items() if count}
    if counts != contents.counts or said.message_count != sum(counts.values()):
        there = sum(contents.counts.values())
        raise Damage(scan.position, f"{there} messages are there where its index counts {said.message_count}")


def _reach(streams: dict[str, Stream]) -> str:
    """How far the messages of `streams` reach, as half a sentence."""
    ends = [stream.head["log_time"][-1] for stream in streams.values() if len(stream.records)]
    if not ends:
        return "up to its metadata, no chunk is complete"
    return f"up to {max(ends) / NANOSECONDS:.3f} s, its last complete chunk"
