"""Comparison of two logs signal by signal: errors, and departures of the second from the tube around the first."""

import filecmp
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import Log, LogSeries
from twin.kernel.recording.logs.reader import LogKind, is_recording, kind_of, read_log
from twin.kernel.recording.reader import read_metadata
from twin.robot.assembly.declared import DECLARED_TABLES
from twin.robot.experiment.differences import differing_values, recorded_comparable_values
from twin.studies.compare.signal_row import SignalRow, TubeCurves, signal_row, tube_curves
from twin.studies.compare.tolerance import (
    Alignment,
    Rule,
    TimeShift,
    allowance,
    common_units,
    matches,
    no_overlap,
    signal_ranges,
    time_shift,
)
from twin.studies.paper.digitised.provenance import provenance

Differences = dict[str, tuple[str, ...]]
NO_ALIGNMENT = Alignment()


def read_logs(
    a: Path, b: Path, maps: Sequence[str] = (), part: tuple[float | None, float | None] = (None, None)
) -> tuple[Log, Log]:
    """Read the compared time span `part` (s) of two logs; a CSV may name signals of the other, see `read_csv`."""
    columns = column_map(maps)
    if columns and is_recording(a) and is_recording(b):
        raise InputRefused("--map: both are recordings of twin, whose signals have their names; leave it out")
    found: dict[int, Log] = {}
    known: dict[str, str] = {}
    for place, path in sorted(enumerate((a, b)), key=lambda one: kind_of(one[1]) is LogKind.CSV):
        log = found[place] = read_log(path, columns, part, known)
        known = {name: series.unit for name, series in log.series.items()}
    return found[0], found[1]


def experiments_differ(a: Path, b: Path) -> Differences | None:
    """Return the differences of two runs' experiments, key -> (in A, in B); None if either records no experiment."""
    if not (is_recording(a) and is_recording(b)):
        return None
    try:
        found = [read_metadata(path) for path in (a, b)]
        if any("experiment" not in metadata for metadata in found):
            return None
        values = [recorded_comparable_values(DECLARED_TABLES, *one) for one in zip(found, (a, b), strict=True)]
        return differing_values(values)
    except InputRefused:
        return None


@dataclass(frozen=True)
class Comparison:
    """Comparison of all signals that two logs share.

    Attributes:
        a, b: files of the reference and of the compared log.
        shift: time shift added to b.
        rows: worst first.
        disjoint: common signals without a common instant.
        most: larger number of signals to compare of the two logs.
    """

    a: Path
    b: Path
    shift: TimeShift
    rows: tuple[SignalRow, ...]
    curves: dict[str, TubeCurves]
    disjoint: tuple[str, ...]
    only_a: tuple[str, ...]
    only_b: tuple[str, ...]
    most: int
    identical: bool
    notes: tuple[str, ...]

    @property
    def outside_rows(self) -> tuple[SignalRow, ...]:
        """Signals that leave their tolerance tube, in the order of their first departure."""
        left = [row for row in self.rows if row.first_exit]
        return tuple(sorted(left, key=lambda row: row.first_exit.t if row.first_exit else 0.0))

    @property
    def least_coverage(self) -> tuple[str, float]:
        """The signal of the first log that the second log covers least, and the covered share of its time."""
        shares = [(row.signal, row.covered) for row in self.rows] + [(name, 0.0) for name in self.disjoint]
        return min(shares, key=lambda share: share[1])

    @property
    def is_inside(self) -> bool:
        return not self.outside_rows

    JSON_KEYS = "a b identical inside=is_inside covered=least_coverage.1 shift=shift.seconds rows only_a only_b notes"


def compare_logs(
    a: Log,
    b: Log,
    given: Sequence[Rule] = (),
    signals: Sequence[str] = (),
    how: Alignment = NO_ALIGNMENT,
) -> Comparison:
    """Compare a log with a reference log, signal by signal, within tolerance tubes.

    Values are compared at the samples of the log with the lower rate, in the time that both cover and outside of the
    gaps of both; the other log is interpolated linearly there, never beyond its ends.

    Args:
        given: tolerance rules, applied after the default and the stated uncertainty of a digitised curve.
        signals: patterns of the signals to compare; empty for all common ones.
    """
    units = common_units(a, b, signals, given)
    digitised = [read for log in (a, b) if (read := provenance(log))]
    stated = [Rule(d.signal, d.value, units[d.signal].dimension, d.time) for d in digitised if d.signal in units]
    moved = time_shift(a, b, how)
    widest = signal_ranges(a)
    rows, of_signals, apart = [], {}, []
    for name, unit in units.items():
        ours, theirs = a[name], b[name]
        theirs = LogSeries(theirs.t + moved.seconds, theirs.values, theirs.unit)
        span, magnitude = widest[name.partition("[")[0]], float(np.nanmax(np.abs(ours.values)))
        allowed = allowance(name, unit, span, magnitude, [*stated, *given])
        found = tube_curves(ours, theirs, allowed)
        if len(found.t):
            of_signals[name] = found
            rows.append(signal_row(name, ours, theirs, allowed, found, span))
        else:
            apart.append(name)
    if not rows:
        raise InputRefused(no_overlap(a, b, apart[0], moved.seconds))
    notes = [read.text for read in digitised]
    notes += [f"{log.path.name}: {note}" for log in (a, b) for note in log.notes]
    notes += [f"no instants in common: {', '.join(apart)}"] if apart else []
    notes += [moved.note] if moved.note else []
    rows.sort(key=lambda row: (-row.used, -row.max_error / (row.span or 1.0), row.signal))
    same = _same_bytes(a.path, b.path)
    only_a, only_b = (tuple(n for n in log.series if n not in other.series) for log, other in ((a, b), (b, a)))
    return Comparison(
        a=a.path,
        b=b.path,
        shift=moved,
        rows=tuple(rows),
        curves=of_signals,
        disjoint=tuple(apart),
        only_a=only_a,
        only_b=only_b,
        most=max(sum(not signals or any(matches(p, n) for p in signals) for n in log.series) for log in (a, b)),
        identical=same,
        notes=tuple(dict.fromkeys(notes)),
    )


def _same_bytes(a: Path, b: Path) -> bool:
    """Whether two files, or the files of two bags, have the same content."""
    of_a, of_b = ([path] if path.is_file() else sorted(path.iterdir()) for path in (a, b))
    return len(of_a) == len(of_b) and all(
        one.is_file() and other.is_file() and filecmp.cmp(one, other, shallow=False)
        for one, other in zip(of_a, of_b, strict=True)
    )
