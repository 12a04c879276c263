"""From a recording or a log to one file of another format, or a bag of ROS 2."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from twin.errors import InputRefused
from twin.recording.export.foreign import recording_of
from twin.recording.export.formats import write_csv, write_matlab, write_parquet
from twin.recording.export.ros_bag import write_ros_bag
from twin.recording.export.selection import selected_signals
from twin.recording.export.table import table
from twin.recording.folder import recording_in
from twin.recording.logs.bag import is_bag
from twin.recording.logs.column_map import column_map
from twin.recording.logs.reader import is_recording, read_log
from twin.recording.reader import read
from twin.recording.recording import Recording

Format = Literal["csv", "parquet", "mat", "ros2"]


@dataclass(frozen=True)
class Exported:
    """What was written.

    Attributes:
        path: the file, of a bag the folder.
        signals: how many.
        rows: of the longest of them; of a bag, its messages.
        note: what is wrong with the recording; empty if nothing.
    """

    path: Path
    signals: int
    rows: int
    note: str


def export_recording(
    run: Path,
    form: Format,
    patterns: Sequence[str] = (),
    rate: float | None = None,
    out: Path | None = None,
    force: bool = False,
    maps: Sequence[str] = (),
) -> Exported:
    """Write the recording meant by `run`, or another tool's log, in another format.

    Args:
        run: see `recording_in`; with `maps`, or if it is a bag of ROS 2, see `read_log`.
        form: of the file.
        patterns: see `selected_signals`.
        rate: see `table` (Hz).
        out: the file; without it, the recording's own path with the format's suffix.
        force: replace what is there.
        maps: see `column_map`; which columns of a log that twin did not record are which signals.

    Raises:
        InputRefused: no recording, no such signal, no such rate, no pyarrow, a file in the way.
        NotWritten: the disk refuses; a file that was there stays.
    """
    recording = _recording(run, maps)
    signals = selected_signals(recording, patterns)
    stem = recording.path.name.split(".")[0]
    path = out or recording.path.with_name(f"{stem}_ros2" if form == "ros2" else f"{stem}.{form}")
    if os.path.lexists(path) and not force:
        raise InputRefused(f"{path}: already there; replace it with --force or name another with --out")
    if form == "ros2":
        return Exported(path, len(signals), write_ros_bag(path, recording, signals, rate), recording.note)
    if form == "mat":
        return Exported(path, len(signals), write_matlab(path, recording, signals, rate), recording.note)
    rows = table(recording, signals, rate)
    if form == "csv":
        write_csv(path, rows)
    else:
        write_parquet(path, rows, recording.metadata)
    return Exported(path, len(signals), len(rows.t), recording.note)


def _recording(run: Path, maps: Sequence[str]) -> Recording:
    if not maps and not is_bag(run):
        return read(recording_in(run))
    if is_recording(run):
        raise InputRefused(f"--map: {run} is a recording of twin, with names and units of its own")
    return recording_of(read_log(run, column_map(maps)))
