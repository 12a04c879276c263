"""Reader of logs of any kind."""

import math
import os
import sys
from collections.abc import Mapping
from dataclasses import replace
from datetime import UTC, datetime
from enum import Enum, auto
from pathlib import Path

import numpy as np

from twin.kernel.errors import InputRefused
from twin.kernel.files import open_regular
from twin.kernel.recording.folder import recording_in
from twin.kernel.recording.logs.bag import SQLITE_MAGIC, bag_topics, is_bag
from twin.kernel.recording.logs.csv_file import read_csv
from twin.kernel.recording.logs.log import Log, LogError, LogSeries, MappedColumn
from twin.kernel.recording.logs.topics import MCAP_MAGIC, LoggedTopic, log_from_topics, mcap_topics, written_by_twin
from twin.kernel.recording.reader import Recording, read

WALL_CLOCK = 1e8
"""Minimum time of a wall clock (s since 1970); a log's own time is below three years."""
MAX_NAMED_BAGS = 5


def read_log(
    path: str | Path,
    columns: Mapping[str, MappedColumn] | None = None,
    part: tuple[float | None, float | None] = (None, None),
    known: Mapping[str, str] | None = None,
) -> Log:
    """Read a log of any kind: a recording of twin, another MCAP file, a ROS 2 bag or a CSV file.

    Args:
        path: a recording's file, run folder or results/EXPERIMENT; a bag's folder or one of its files; a file.
        columns: columns by signal, from `column_map`; ignored for a recording of twin.
        part: start and end (s) of the part to read, by the log's time, None for its own; times of a wall clock count
            from the first one.
        known: unit by name of signals in a CSV file, see `read_csv`.

    LogError, RecordingRefused: missing, empty, damaged, foreign without a map, or with invalid columns.
    """
    path = Path(path)
    match kind_of(path):
        case LogKind.RECORDING:
            return _clip_log(recording_log(read(recording_in(path))), part)
        case LogKind.CSV:
            log = read_csv(path, columns or {}, known)
        case kind:
            topics, notes = topics_in(path, kind, columns or {})
            log = log_from_topics(path, topics, columns or {}, notes)
    return _normalise_log(log, part)


def topics_in(
    path: Path, kind: "LogKind", columns: Mapping[str, MappedColumn]
) -> tuple[dict[str, LoggedTopic], list[str]]:
    """Read the topics of a bag or of a foreign MCAP file, with messages of `columns`, and notes on missing data."""
    return (bag_topics if kind == LogKind.BAG else mcap_topics)(path, columns)


class LogKind(Enum):
    """Kind of a log: a recording of twin, a ROS 2 bag, another MCAP file, a table."""

    RECORDING = auto()
    BAG = auto()
    MCAP = auto()
    CSV = auto()


def kind_of(path: Path) -> LogKind:
    """Determine the kind of a log from its first bytes."""
    if is_recording(path):
        return LogKind.RECORDING
    if os.path.isdir(path):
        return LogKind.BAG
    if path.exists() and not path.is_file():
        raise LogError(f"{path}: not a regular file but a pipe, socket or device; expected a file")
    with open_regular(path, sys.maxsize) as file:
        magic = file.read(len(SQLITE_MAGIC))
    if is_bag(path) or magic == SQLITE_MAGIC:
        return LogKind.BAG
    if magic.startswith(MCAP_MAGIC):
        return LogKind.MCAP
    if path.suffix == ".mcap" or path.name.endswith(".mcap.partial"):
        what = "not an MCAP file" if magic else "an empty file"
        raise LogError(f"{path}: {what}; expected a recording")
    return LogKind.CSV


def is_recording(path: Path) -> bool:
    """Check whether `path` means a recording of twin, which needs no column map."""
    # Path.exists would raise for a too long name
    if is_bag(path):
        return False
    if os.path.isdir(path) and (bags := [str(one) for one in sorted(path.iterdir()) if one.is_dir() and is_bag(one)]):
        try:
            recording_in(path)
        except InputRefused:
            raise LogError(f"{path}: no recording, but the bag {', '.join(bags[:MAX_NAMED_BAGS])}; name it") from None
    if os.path.isdir(path) or (not os.path.lexists(path) and not path.suffix):
        return True
    return os.path.isfile(path) and written_by_twin(path)


def recording_log(recording: Recording) -> Log:
    """Convert a recording of twin to a log of numbers, without topics that have fewer than two samples."""
    series: dict[str, LogSeries] = {}
    for key, field in recording.fields().items():
        t = recording.time(key.rpartition(".")[0])
        if len(t) < 2:
            continue
        columns = recording[key].astype(np.float64).reshape(len(t), field.size).T
        names = [key] if field.size == 1 else [f"{key}[{i}]" for i in range(field.size)]
        for name, column in zip(names, columns, strict=True):
            series[name] = LogSeries(t, np.ascontiguousarray(column), field.unit)
    if not series:
        raise LogError(f"{recording.path}: holds no samples{f'; {recording.note}' if recording.note else ''}")
    return Log(recording.path, series, (*filter(None, [recording.note]), *recording.deviations))


def _clip_log(log: Log, part: tuple[float | None, float | None]) -> Log:
    """Return the given `part` of a log; series with fewer than two samples in it are left out."""
    if part == (None, None):
        return log
    start, end = interval(log.path, part)
    series = {name: found for name, one in log.series.items() if len((found := one.clip(start, end)).t) > 1}
    if not series:
        first, last = (f(float(one.t[k]) for one in log.series.values()) for f, k in ((min, 0), (max, -1)))
        raise no_samples_error(log.path, start, end, first, last)
    return replace(log, series=series)


def interval(where: Path | str, part: tuple[float | None, float | None]) -> tuple[float, float]:
    """Return start and end (s) of a requested part of a log; infinite if not given."""
    start, end = -math.inf if part[0] is None else part[0], math.inf if part[1] is None else part[1]
    if not start < end:
        raise LogError(f"{where}: from {start:g} to {end:g} s: expected a start before the end")
    return start, end


def no_samples_error(where: Path | str, start: float, end: float, first: float, last: float) -> LogError:
    """Create the error for a requested part (s) without samples, of a log from `first` to `last` (s)."""
    return LogError(f"{where}: no samples from {start:g} to {end:g} s; it has {first:g} to {last:g} s")


def _normalise_log(log: Log, part: tuple[float | None, float | None]) -> Log:
    """Finish a log: count times of a wall clock from the first sample, select the `part`, note missing samples."""
    notes = list(log.notes)
    series = log.series
    start = min(float(one.t[0]) for one in series.values())
    if start > WALL_CLOCK:
        # keep shared time arrays shared
        shifted = {id(one.t): one.t - start for one in series.values()}
        series = {name: replace(one, t=shifted[id(one.t)], invalid=one.invalid - start) for name, one in series.items()}
        notes.append(f"times of a clock: they count from its {start:.3f} s, {_date(start)}")
    series = _clip_log(replace(log, series=series), part).series
    missing: dict[str, list[str]] = {}
    for name, one in series.items():
        few = len(one.invalid)
        invalid = f"{few} of {len(one.t) + few} samples are not a number and are left out" if few else ""
        for note in (invalid, one.sampling.note):
            if note:
                missing.setdefault(note, []).append(name)
    for note, names in missing.items():
        notes.append(note if len(names) == len(series) else f"{', '.join(names)}: {note}")
    return replace(log, series=series, notes=tuple(notes))


def _date(seconds: float) -> str:
    try:
        return f"{datetime.fromtimestamp(seconds, UTC):%Y-%m-%d %H:%M:%S} UTC"
    except (ValueError, OverflowError, OSError):
        return "which is not a date"
