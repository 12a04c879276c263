"""Export of a recording or log to a file of another format, or to a ROS 2 bag."""

import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Literal

import numpy as np

from twin.kernel.errors import InputRefused, nearest
from twin.kernel.recording import messages
from twin.kernel.recording.export.ros_bag import JointFields, write_ros_bag
from twin.kernel.recording.export.table import signal_table, write_csv, write_matlab, write_parquet
from twin.kernel.recording.folder import recording_in
from twin.kernel.recording.logs.bag import is_bag
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import Log, LogError, LogSeries
from twin.kernel.recording.logs.reader import is_recording, read_log
from twin.kernel.recording.reader import Recording, Stream, read
from twin.kernel.recording.scan import NS_PER_S

Format = Literal["csv", "parquet", "mat", "ros2"]
MAX_LISTED_TOPICS = 8


@dataclass(frozen=True)
class ExportResult:
    """Outcome of an export: file (folder of a bag), signals, rows of the longest signal (messages of a bag).

    `note` has the defects of the recording; empty if it is complete.
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
    joints: JointFields | None = None,
) -> ExportResult:
    """Export a recording (see `recording_in`), or another tool's log (with `maps` or a ROS 2 bag), to another format.

    `patterns` are as for `selected_signals`, `rate` (Hz) as for `signal_table`, `maps` as for `column_map`. `joints`
    are fields that a bag stores as JointState. Without `out`, the path is the recording's with the format's suffix.
    """
    recording = _load_recording(run, maps)
    signals = selected_signals(recording, patterns)
    stem = recording.path.name.split(".")[0]
    path = out or recording.path.with_name(f"{stem}_ros2" if form == "ros2" else f"{stem}.{form}")
    if os.path.lexists(path) and not force:
        raise InputRefused(f"{path}: exists; replace it with --force or name another with --out")
    if form == "ros2":
        rows = write_ros_bag(path, recording, signals, rate, joints or {})
    elif form == "mat":
        rows = write_matlab(path, recording, signals, rate)
    else:
        table = signal_table(recording, signals, rate)
        rows = len(table.t)
        if form == "csv":
            write_csv(path, table)
        else:
            write_parquet(path, table, recording.metadata)
    return ExportResult(path, len(signals), rows, recording.note)


def _load_recording(run: Path, maps: Sequence[str]) -> Recording:
    own = is_recording(run)
    if not maps and not is_bag(run):
        return read(recording_in(run))
    if own:
        raise InputRefused(f"--map: {run} is a recording of twin, whose names and units are known")
    return recording_from_log(read_log(run, column_map(maps)))


def selected_signals(recording: Recording, patterns: Sequence[str] = ()) -> tuple[str, ...]:
    """Return the names `topic.field` of a recording that match any of `patterns`, in file order; all without.

    A pattern is `arm.tip`, has wildcards, `arm.*`, `*.force`, or selects all fields of a topic, `arm`.
    """
    fields = recording.fields()
    for pattern in patterns:
        if not any(_matches(name, pattern) for name in fields):
            raise InputRefused(f"{recording.path}: no signal is called {pattern}; {_nearest(pattern, fields)}")
    chosen = tuple(name for name in fields if not patterns or any(_matches(name, pattern) for pattern in patterns))
    empty = {topic for topic, stream in recording.streams.items() if not len(stream.records)}
    without = [name for name in chosen if name.rpartition(".")[0] in empty]
    if without or not chosen:
        raise InputRefused(f"{recording.path}: {without[0] if without else 'the recording'} has no messages to export")
    return chosen


def _matches(name: str, pattern: str) -> bool:
    return fnmatchcase(name, pattern) or name.rpartition(".")[0] == pattern


def _nearest(pattern: str, fields: dict) -> str:
    names = [*fields, *dict.fromkeys(name.rpartition(".")[0] for name in fields)]
    # wildcards would distort the comparison of names
    wanted, topics = pattern.replace("*", ""), names[len(fields) :]
    more = " ..." if len(topics) > MAX_LISTED_TOPICS else ""
    return nearest(
        wanted, names, f"there are {', '.join(f'{topic}.*' for topic in topics[:MAX_LISTED_TOPICS])}{more}", 3
    )


def recording_from_log(log: Log) -> Recording:
    """Convert another tool's log to a recording: `arm.tip[0]`, `[1]`, ... become the field `tip` of the topic `arm`."""
    topics: dict[str, list[tuple[str, LogSeries]]] = {}
    for name in dict.fromkeys(re.sub(r"\[\d+\]$", "", name) for name in log.series):
        topic, _, own = name.rpartition(".")
        if not messages.TOPIC_NAME.fullmatch(topic) or not messages.FIELD_NAME.fullmatch(own):
            raise LogError(f"{log.path}: signal '{name}' is not TOPIC.FIELD; name it like lab.{own or 'F'} with --map")
        one = log.vector(name) if name not in log.series else log[name]
        topics.setdefault(topic, []).append((own, one))
    return Recording(
        log.path, {topic: _stream(log, topic, own) for topic, own in topics.items()}, [], {}, True, "; ".join(log.notes)
    )


def _stream(log: Log, topic: str, series: list[tuple[str, LogSeries]]) -> Stream:
    t = series[0][1].t
    for name, one in series:
        if not np.array_equal(one.t, t):
            raise LogError(
                f"{log.path}: {topic}.{series[0][0]} and {topic}.{name} have other times; name one of them for another "
                f"topic, such as {topic}2.{name}"
            )
    if t[0] < 0.0:
        raise LogError(f"{log.path}: {topic} begins at {t[0]:g} s; expected times from 0 on")
    columns = [one.values.reshape(len(t), -1) for _, one in series]
    fields = tuple(
        messages.Field(name, values.shape[1], "double", one.unit, f"as {log.path.name} has it")
        for (name, one), values in zip(series, columns, strict=True)
    )
    layout = messages.message_layout(1, fields)
    times = np.rint(t * NS_PER_S).astype(np.int64)
    return Stream(fields, layout, layout.filling.records(times, 0, np.concatenate(columns, axis=1)))
