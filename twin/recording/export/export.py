"""From a recording to one file of another format."""

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from twin.errors import InputRefused
from twin.recording.export.formats import write_csv, write_matlab, write_parquet
from twin.recording.export.selection import selected_signals
from twin.recording.export.table import table
from twin.recording.folder import recording_in
from twin.recording.reader import read

Format = Literal["csv", "parquet", "mat"]


@dataclass(frozen=True)
class Exported:
    """What was written.

    Attributes:
        path: the file.
        signals: how many.
        rows: of the longest of them.
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
) -> Exported:
    """Write the recording meant by `run` in another format.

    Args:
        run: see `recording_in`.
        form: of the file.
        patterns: see `selected_signals`.
        rate: see `table` (Hz).
        out: the file; without it, the recording's own path with the format's suffix.
        force: replace what is there.

    Raises:
        InputRefused: no recording, no such signal, no such rate, no pyarrow, a file in the way.
        NotWritten: the disk refuses; a file that was there stays.
    """
    recording = read(recording_in(run))
    signals = selected_signals(recording, patterns)
    path = out or recording.path.with_name(f"{recording.path.name.split('.')[0]}.{form}")
    if os.path.lexists(path) and not force:
        raise InputRefused(f"{path}: already there; replace it with --force or name another with --out")
    if form == "mat":
        return Exported(path, len(signals), write_matlab(path, recording, signals, rate), recording.note)
    rows = table(recording, signals, rate)
    if form == "csv":
        write_csv(path, rows)
    else:
        write_parquet(path, rows, recording.metadata)
    return Exported(path, len(signals), len(rows.t), recording.note)
