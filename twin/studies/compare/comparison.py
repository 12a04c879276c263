"""Two logs signal by signal: errors, and where the second leaves the tube around the first."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twin.recording.logs.log import Log, LogSeries
from twin.studies.compare.alignment import Alignment, TimeShift, shift
from twin.studies.compare.pairing import no_overlap, paired, spans
from twin.studies.compare.row import SignalRow, TubeCurves, curves, row
from twin.studies.compare.tolerance import ComparisonRefused, Rule, allowance
from twin.studies.paper.digitised.provenance import provenance
from twin.writing import finite

IN_PLACE = Alignment()


@dataclass(frozen=True)
class Comparison:
    """All signals that two logs share.

    Attributes:
        a, b: the reference, and what was compared with it.
        shift: what was added to the times of b.
        rows: worst first.
        curves: by signal.
        apart: signals of both that have no instant in common.
        only_a, only_b: signals that the other has not.
        identical: whether the two files hold the same bytes.
        notes: sentences on what is doubtful.
    """

    a: Path
    b: Path
    shift: TimeShift
    rows: tuple[SignalRow, ...]
    curves: dict[str, TubeCurves]
    apart: tuple[str, ...]
    only_a: tuple[str, ...]
    only_b: tuple[str, ...]
    identical: bool
    notes: tuple[str, ...]

    @property
    def outside(self) -> tuple[SignalRow, ...]:
        """Signals that leave their tube, in the order in which they do."""
        left = [row for row in self.rows if row.first_exit]
        return tuple(sorted(left, key=lambda row: row.first_exit.t if row.first_exit else 0.0))

    @property
    def least_covered(self) -> tuple[str, float]:
        """The signal of which b covers least, and the share of a's time that it covers."""
        shares = [(row.signal, row.covered) for row in self.rows] + [(name, 0.0) for name in self.apart]
        return min(shares, key=lambda share: share[1])

    def facts(self) -> dict[str, Any]:
        """Everything but the curves, for JSON; SI units, None for what is infinite or not a number."""
        return finite({
            "a": str(self.a),
            "b": str(self.b),
            "identical": self.identical,
            "inside": not self.outside,
            "covered": self.least_covered[1],
            "shift": self.shift.seconds,
            "rows": [asdict(row) | {"inside": row.first_exit is None} for row in self.rows],
            "only_a": self.only_a,
            "only_b": self.only_b,
            "notes": self.notes,
        })  # fmt: skip


def compared(
    a: Log,
    b: Log,
    given: Sequence[Rule] = (),
    signals: Sequence[str] = (),
    how: Alignment = IN_PLACE,
) -> Comparison:
    """Compare `b` with the reference `a`.

    Values are compared at the instants of whichever samples the signal more sparsely, in the time that both cover
    and outside of the gaps of both; there the other is interpolated linearly, never beyond its ends.

    Args:
        a, b: the logs.
        given: rules of tolerance, after the default and the uncertainty that a digitised curve states.
        signals: patterns of the signals to compare; empty: all that both have.
        how: to align the times.

    Raises:
        ComparisonRefused: no signal in common, units of different dimensions, no overlap in time, a pattern that fits
            no signal, a tolerance in another dimension; every mistake, each in one sentence.
        LogRefused: the signal to align by is not there.
    """
    units = paired(a, b, signals, given)
    digitised = [read for log in (a, b) if (read := provenance(log))]
    stated = [Rule(d.signal, d.value, units[d.signal].dimension, d.time) for d in digitised if d.signal in units]
    moved = shift(a, b, how)
    widest = spans(a)
    rows, of_signals, apart = [], {}, []
    for name, unit in units.items():
        ours, theirs = a[name], b[name]
        theirs = LogSeries(theirs.t + moved.seconds, theirs.values, theirs.unit)
        span, magnitude = widest[name.partition("[")[0]], float(np.nanmax(np.abs(ours.values)))
        allowed = allowance(name, unit, span, magnitude, [*stated, *given])
        found = curves(ours, theirs, allowed)
        if len(found.t):
            of_signals[name] = found
            rows.append(row(name, ours, theirs, allowed, found, span))
        else:
            apart.append(name)
    if not rows:
        raise ComparisonRefused(no_overlap(a, b, apart[0], moved.seconds))
    notes = [read.text for read in digitised]
    notes += [f"{log.path.name}: {note}" for log in (a, b) for note in log.notes]
    notes += [f"no instants in common: {', '.join(apart)}"] if apart else []
    notes += [moved.note] if moved.note else []
    rows.sort(key=lambda row: (-row.used, -row.max_error / (row.span or 1.0), row.signal))
    same = a.path.stat().st_size == b.path.stat().st_size and a.path.read_bytes() == b.path.read_bytes()
    only_a, only_b = (tuple(n for n in log.series if n not in other.series) for log, other in ((a, b), (b, a)))
    return Comparison(
        a=a.path,
        b=b.path,
        shift=moved,
        rows=tuple(rows),
        curves=of_signals,
        apart=tuple(apart),
        only_a=only_a,
        only_b=only_b,
        identical=same,
        notes=tuple(dict.fromkeys(notes)),
    )
