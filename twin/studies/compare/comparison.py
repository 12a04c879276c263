"""Two logs signal by signal: errors, and where the second leaves the tube around the first."""

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
    ComparisonError,
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


def read_logs(
    a: Path, b: Path, maps: Sequence[str] = (), part: tuple[float | None, float | None] = (None, None)
) -> tuple[Log, Log]:
    """The logs in `a` and `b`.

    Names in a CSV file may mean signals of the other log, see `read_csv`; `part` is start and end (s) of what is
    compared.
    """
    columns = column_map(maps)
    if columns and is_recording(a) and is_recording(b):
        raise ComparisonError("--map: both are recordings of twin, whose signals have their names; leave it out")
    found: dict[int, Log] = {}
    known: dict[str, str] = {}
    for place, path in sorted(enumerate((a, b)), key=lambda one: kind_of(one[1]) is LogKind.CSV):
        log = found[place] = read_log(path, columns, part, known)
        known = {name: series.unit for name, series in log.series.items()}
    return found[0], found[1]


Differences = dict[str, tuple[str, ...]]


def experiments_differ(a: Path, b: Path) -> Differences | None:
    """(in A, in B) of what is not the same, by key; None: one of them is no run of the twin, and says of none."""
    if not (is_recording(a) and is_recording(b)):
        return None
    try:
        found = [read_metadata(path) for path in (a, b)]
        if any("experiment" not in metadata for metadata in found):
            return None
        return differing_values(
            [
                recorded_comparable_values(DECLARED_TABLES, metadata, path)
                for metadata, path in zip(found, (a, b), strict=True)
            ]
        )
    except InputRefused:
        return None


NO_ALIGNMENT = Alignment()


@dataclass(frozen=True)
class Comparison:
    """All signals that two logs share.

    Attributes:
        a, b: the reference, and what was compared with it.
        shift: what was added to the times of b.
        rows: worst first.
        apart: signals of both that have no instant in common.
        most: number of signals to compare of the log that has more of them.
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
        """Signals that leave their tube, in the order in which they do."""
        left = [row for row in self.rows if row.first_exit]
        return tuple(sorted(left, key=lambda row: row.first_exit.t if row.first_exit else 0.0))

    @property
    def least_coverage(self) -> tuple[str, float]:
        """The signal of which b covers least, and the share of a's time that it covers."""
        shares = [(row.signal, row.covered) for row in self.rows] + [(name, 0.0) for name in self.disjoint]
        return min(shares, key=lambda share: share[1])

    @property
    def is_inside(self) -> bool:
        """Whether no signal leaves its tube."""
        return not self.outside_rows

    JSON_KEYS = "a b identical inside=is_inside covered=least_coverage.1 shift=shift.seconds rows only_a only_b notes"


def compare_logs(
    a: Log,
    b: Log,
    given: Sequence[Rule] = (),
    signals: Sequence[str] = (),
    how: Alignment = NO_ALIGNMENT,
) -> Comparison:
    """Compare `b` with the reference `a`.

    Values are compared at the instants of whichever samples the signal more sparsely, in the time that both cover
    and outside of the gaps of both; there the other is interpolated linearly, never beyond its ends.

    Args:
        given: rules of tolerance, after the default and the uncertainty that a digitised curve states.
        signals: patterns of the signals to compare; empty: all that both have.
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
        raise ComparisonError(no_overlap(a, b, apart[0], moved.seconds))
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
