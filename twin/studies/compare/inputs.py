"""The two files to compare."""

from collections.abc import Sequence
from pathlib import Path

from twin.recording.logs.column_map import column_map
from twin.recording.logs.log import Log
from twin.recording.logs.reader import is_recording, read_log
from twin.studies.compare.tolerance import ComparisonRefused


def both(a: Path, b: Path, maps: Sequence[str] = ()) -> tuple[Log, Log]:
    """The logs in `a` and `b`; `maps` are entries of a column map for those that twin did not record.

    Raises:
        ComparisonRefused: a map, but nothing to map.
        LogRefused, RecordingRefused: as `read_log` and `column_map`.
    """
    columns = column_map(maps)
    if columns and is_recording(a) and is_recording(b):
        raise ComparisonRefused("--map: both are recordings of twin, whose signals have their names; leave it out")
    return read_log(a, columns), read_log(b, columns)
