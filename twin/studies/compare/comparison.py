"""Two logs signal by signal: errors, and where the second leaves the tube around the first.

One signal of two logs: its errors, and where it leaves the tube.

What differs in the experiments of two runs that are compared.

A comparison as text of at most 80 columns and as a picture: the answer first.
"""

import filecmp
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.log import Log, LogSeries, in_gap, sampling
from twin.kernel.recording.logs.reader import LogKind, is_recording, kind_of, read_log
from twin.kernel.recording.reader import origin
from twin.kernel.serialise import to_dict
from twin.robot.assembly.declared import DECLARED
from twin.robot.experiment.differences import differing, recorded_facts
from twin.studies.compare.tolerance import (
    Alignment,
    Allowance,
    ComparisonRefused,
    Curve,
    Rule,
    TimeShift,
    Tube,
    allowance,
    matches,
    no_overlap,
    paired,
    reach,
    shift,
    some_signals,
    spans,
)
from twin.studies.figure import PAPER_BLUE, PAPER_ORANGE, Axes, picture
from twin.studies.metrics.response import rms
from twin.studies.paper.digitised.provenance import provenance
from twin.studies.result import Block, Cell, Column, Note, Result, Table, counted, cut, some


def both(
    a: Path, b: Path, maps: Sequence[str] = (), part: tuple[float | None, float | None] = (None, None)
) -> tuple[Log, Log]:
    """The logs in `a` and `b`.

    Names in a CSV file may mean signals of the other log, see `read_csv`; `part` is start and end (s) of what is
    compared.
    """
    columns = column_map(maps)
    if columns and is_recording(a) and is_recording(b):
        raise ComparisonRefused("--map: both are recordings of twin, whose signals have their names; leave it out")
    found: dict[int, Log] = {}
    known: dict[str, str] = {}
    for place, path in sorted(enumerate((a, b)), key=lambda one: kind_of(one[1]) is LogKind.CSV):
        log = found[place] = read_log(path, columns, part, known)
        known = {name: series.unit for name, series in log.series.items()}
    return found[0], found[1]


LOST_SAMPLE = 2.0
"""Periods. Two samples so far apart are as dense as a log of half the rate, which covers all that it spans; one that is
lost now and then is no hole."""


@dataclass(frozen=True)
class Exit:
    """A value outside of the tube: time (s), value and the bounds there."""

    t: float
    value: float
    lower: float
    upper: float


@dataclass(frozen=True)
class SignalRow:
    """One signal; SI units. Errors are the second log's value less the first's, at the same time.

    Attributes:
        covered: share of the reference's time on which the second has values; see `coverage`.
        max_error, max_error_at: largest absolute error and its time, s.
        rms_error, mean_error: over the instants.
        span: range of the reference, which shares of it refer to.
        used: share of the tolerance that the worst value takes after the tolerance in time; inside is up to 1.
        outside: how many instants are outside of the tube.
    """

    signal: str
    unit: str
    n: int
    covered: float
    max_error: float
    max_error_at: float
    rms_error: float
    mean_error: float
    span: float
    allowance: Allowance
    used: float
    outside: int
    first_exit: Exit | None
    inside: bool


@dataclass(frozen=True)
class TubeCurves:
    """What a row was computed from: instants t (s), the two values there, the reach and the tube, all (n,)."""

    t: Curve
    a: Curve
    b: Curve
    reach: Tube
    tube: Tube


def curves(ours: LogSeries, theirs: LogSeries, allowed: Allowance) -> TubeCurves:
    """Both signals and the tube at the instants of whichever is sampled more sparsely, without gaps; n may be 0."""
    start, end = max(ours.t[0], theirs.t[0]), min(ours.t[-1], theirs.t[-1])
    count = [np.sum((series.t >= start) & (series.t <= end)) for series in (ours, theirs)]
    t = ours.t if count[0] <= count[1] else theirs.t
    t = t[(t >= start) & (t <= end) & ~in_gap(t, ours.sampling.gaps) & ~in_gap(t, theirs.sampling.gaps)]
    bounds = reach(ours.t, ours.values, t, allowed.dt)
    return TubeCurves(
        t,
        np.interp(t, ours.t, ours.values),
        np.interp(t, theirs.t, theirs.values),
        bounds,
        bounds.widened(allowed.value),
    )


def row(
    signal: str, ours: LogSeries, theirs: LogSeries, allowed: Allowance, found: TubeCurves, span: float
) -> SignalRow:
    """What `found`, of at least one instant, comes to."""
    error = found.b - found.a
    # a value that is none is as wrong as can be
    size = np.where(np.isfinite(error), np.abs(error), np.inf)
    worst = int(np.argmax(size))
    excess = np.abs(found.tube.excess(found.b))
    out = np.flatnonzero(excess > 0.0)
    first = None
    if len(out):
        k = out[0]
        first = Exit(*(float(x[k]) for x in (found.t, found.b, found.tube.lower, found.tube.upper)))
    off = float(np.max(np.abs(found.reach.excess(found.b))))
    used = off / allowed.value if allowed.value else (np.inf if len(out) else 0.0)
    return SignalRow(
        signal=signal,
        unit=ours.unit,
        n=len(found.t),
        covered=coverage(ours, theirs),
        max_error=float(size[worst]),
        max_error_at=float(found.t[worst]),
        rms_error=float(np.sqrt(np.mean(error**2))),
        mean_error=float(np.mean(error)),
        span=span,
        allowance=allowed,
        used=float(used),
        outside=len(out),
        first_exit=first,
        inside=first is None,
    )


def coverage(ours: LogSeries, theirs: LogSeries) -> float:
    """Share of the time of `ours` that `theirs` covers, 0 .. 1; exactly 1 if it covers all of it.

    A sampled signal begins up to a period after its source and ends up to a period before it, so a period of the
    coarser of the two is no lack at either end. Gaps are holes from more than one lost sample on, except where `ours`
    has a gap, too.
    """
    period = max(ours.sampling.period, theirs.sampling.period)
    # stamps of nanoseconds as doubles
    slack = period * (1.0 + 1e-6)
    start, end = float(ours.t[0]), float(ours.t[-1])
    early, late = float(theirs.t[0]) - start, end - float(theirs.t[-1])
    holes = theirs.sampling.gaps
    holes = holes[np.diff(holes, axis=1)[:, 0] > LOST_SAMPLE * slack]
    ends = [(start, start + early)] * (early > slack) + [(end - late, end)] * (late > slack)
    lost = np.clip(np.array([*ends, *holes]).reshape(-1, 2), start, end)
    # how much of the time before is in gaps of its own: constant outside of them
    own = ours.sampling.gaps
    gone = np.repeat(np.cumsum([0.0, *np.diff(own, axis=1)[:, 0]]), 2)
    breaks = np.array([start, *own.ravel(), end])
    in_own = np.diff(np.interp(lost, breaks, gone), axis=1)
    missing = float(np.sum(np.diff(lost, axis=1) - in_own))
    return 1.0 if missing <= 0.0 else max(0.0, 1.0 - missing / (end - start - float(gone[-1])))


FEW = 8
"""The most differences in the text; the JSON has all."""
LONG = 24
"""Characters of a value in the text."""

Differences = dict[str, tuple[str, ...]]


def experiments_differ(a: Path, b: Path) -> Differences | None:
    """(in A, in B) of what is not the same, by key; None: one of them is no run of the twin, and says of none."""
    if not (is_recording(a) and is_recording(b)):
        return None
    try:
        found = [origin(path) for path in (a, b)]
        if any("experiment" not in metadata for metadata in found):
            return None
        return differing(
            [recorded_facts(DECLARED, metadata, path) for metadata, path in zip(found, (a, b), strict=True)]
        )
    except InputRefused:
        return None


def differences_lines(differences: Differences | None) -> list[Note | str]:
    """Parts for the end of a comparison; none if there is nothing to say of experiments."""
    if differences is None:
        return []
    if not differences:
        return ["", "Nothing differs in the experiments."]
    lines = [
        Note(" and ".join(cut(value, LONG) for value in values), f"  {key}  ", later=6, whole=True)
        for key, values in list(differences.items())[:FEW]
    ]
    more = len(differences) - FEW
    rest = [f"  and {counted(more, 'more value')}"] if more > 0 else []
    return ["", "What differs in the experiments, A and B:", *lines, *rest]


IN_PLACE = Alignment()


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
    apart: tuple[str, ...]
    only_a: tuple[str, ...]
    only_b: tuple[str, ...]
    most: int
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

    @property
    def inside(self) -> bool:
        """Whether no signal leaves its tube."""
        return not self.outside

    JSON_KEYS = "a b identical inside covered=least_covered.1 shift=shift.seconds rows only_a only_b notes"


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
        given: rules of tolerance, after the default and the uncertainty that a digitised curve states.
        signals: patterns of the signals to compare; empty: all that both have.
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
    same = _same_bytes(a.path, b.path)
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


MOST_OUTSIDE, MOST_INSIDE = 8, 6
"""Rows printed; all are in the JSON."""
COLUMNS = (
    Column("", 4, left=True),
    Column("signal", left=True),
    Column("unit", 5, left=True),
    Column("max error", 9, ".3g", gap=0),
    Column("at s", 8, ".3f", gap=0),
    Column("rms", 9, ".3g", gap=0),
    Column("mean", 10, ".2g", gap=0),
    Column("of tube", 8, gap=0),
)
SHOWN = {"m": ("mm", 1e3), "m/s": ("mm/s", 1e3), "rad": ("deg", math.degrees(1.0)), "1": ("", 1.0)}
"""Units people read, by those of recordings, and the factor."""


def comparison_result(comparison: Comparison, partial: bool = False, differences: Differences | None = None) -> Result:
    """The answer first, then the files, then signals worst first, then what differs in the experiments."""
    covered = partial or comparison.least_covered[1] == 1.0
    parts = [
        f"  A  {comparison.a}",
        f"  B  {comparison.b}{_shift(comparison)}",
        *(["", *_tables(comparison), *_others(comparison, partial)] if not comparison.identical else []),
        *map(_note, comparison.notes),
        *differences_lines(differences),
    ]
    facts = to_dict(comparison) | {"experiments": differences}
    common = len(comparison.rows) + len(comparison.apart)
    share = f"{common} of {comparison.most} signals in common: " if common < comparison.most else ""
    answer = Note(share + _answer(comparison, partial), later=2, whole=True)
    return Result(answer, parts, facts, exit_code=0 if covered and not comparison.outside else 1)


def shown(unit: str) -> tuple[str, float]:
    """The unit people read for an SI unit, and the factor to it."""
    return SHOWN.get(unit, (unit, 1.0))


def _answer(comparison: Comparison, partial: bool) -> str:
    count = len(comparison.rows)
    if comparison.identical:
        return f"B is identical to A: the same bytes, {count} signals"
    _, covered = comparison.least_covered
    # less than all never reads as all
    of_a = "all" if covered == 1.0 else f"{min(100.0 * covered, 99.9):.3g} %"
    if not comparison.outside and covered < 1.0 and not partial:
        return f"B covers only {of_a} of A's time, within the tolerance tube there"
    if not comparison.outside:
        return f"B stays within the tolerance tube of A: {counted(count, 'signal')}, {of_a} of A's time"
    first = comparison.outside[0]
    when = first.first_exit.t if first.first_exit else math.nan
    left = f"{len(comparison.outside)} of {counted(count, 'signal')} {'leaves' if count == 1 else 'leave'}"
    return f"{left} the tube around A (first: {first.signal}, at {when:.6g} s), compared over {of_a} of A"


def _shift(comparison: Comparison) -> str:
    return f", shifted by {comparison.shift.seconds:+.6g} s" if comparison.shift.seconds else ""


def _tables(comparison: Comparison) -> list[Block]:
    outside = [row for row in comparison.rows if row.first_exit]
    inside = [row for row in comparison.rows if not row.first_exit]
    # the one that the answer names is among them
    first = [row for row in comparison.outside[:1] if row not in outside[:MOST_OUTSIDE]]
    rows = [*outside[: MOST_OUTSIDE - len(first)], *first, *inside[:MOST_INSIDE]]
    left = [
        f"{len(found) - most} more {where}"
        for found, most, where in ((outside, MOST_OUTSIDE, "outside"), (inside, MOST_INSIDE, "inside"))
        if len(found) > most
    ]
    table = Table(COLUMNS, [cells for row in rows for cells in _rows(row)], indent=0)
    return [table, *([f"     and {', '.join(left)}"] if left else [])]


def _rows(row: SignalRow) -> list[Sequence[Cell] | str]:
    unit, factor = shown(row.unit)
    used = ">999 %" if row.used > 9.99 else f"{100.0 * row.used:.0f} %"
    errors = (factor * row.max_error, row.max_error_at, factor * row.rms_error, factor * row.mean_error)
    line = ("OUT" if row.first_exit else "ok", row.signal, unit, *errors, used)
    if row.first_exit is None:
        return [line]
    out = row.first_exit
    bounds = f"{factor * out.lower:.4g} .. {factor * out.upper:.4g}"
    return [line, f"       out at {out.t:.6g} s: {factor * out.value:.4g}, not in {bounds} {unit}"]


def _others(comparison: Comparison, partial: bool) -> Iterable[Block]:
    lacking, covered = comparison.least_covered
    if covered < 1.0 and not partial:
        yield _note(f"{lacking}: what B does not cover of A is not compared; --partial lets that pass")
    for name, names in (("A", comparison.only_a), ("B", comparison.only_b)):
        if names:
            yield _note(f"only in {name}: {some_signals(names, 4)}")


def _note(text: str) -> Note:
    return Note(text, "  note     ", whole=True)


MOST = 6
ALIKE = 0.02
"""Share of a curve's range within which another one, rms, is the same to the eye: a low-pass, a display's steps."""
NAMED = 2
A_COLOUR, B_COLOUR, OUT_COLOUR = PAPER_BLUE, PAPER_ORANGE, "#b3261e"


def draw_comparison(comparison: Comparison, path: Path) -> None:
    """Write the picture of the worst signals, at most MOST of them, to `path` (PNG); what is the same is drawn once."""
    rows = distinct(comparison)[:MOST]
    columns = 1 if len(rows) == 1 else 2
    deep = -(-len(rows) // columns)
    with picture(path, 6.6 * columns, 3.2 * deep + 0.4) as figure:
        grid = figure.add_gridspec(2 * deep, columns, height_ratios=[3, 1] * deep)
        for place, (row, alike) in enumerate(rows):
            line, column = divmod(place, columns)
            above = figure.add_subplot(grid[2 * line, column])
            below = figure.add_subplot(grid[2 * line + 1, column], sharex=above)
            _draw(above, below, row, comparison.curves[row.signal])
            if alike:
                above.set_title(f"as {some(alike, NAMED)}", loc="right", fontsize=8)
        handles, names = figure.axes[0].get_legend_handles_labels()
        files = {"A": f"A  {_tail(comparison.a)}", "B": f"B  {_tail(comparison.b)}"}
        names = [files.get(name, name) for name in names]
        figure.legend(handles, names, loc="outside upper center", ncols=2, fontsize=9)


def distinct(comparison: Comparison) -> list[tuple[SignalRow, list[str]]]:
    """Signals worst first, each with those after it that show the same in both logs: one force has many names."""
    found: list[tuple[SignalRow, list[str]]] = []
    for row in comparison.rows:
        first = next((one for one in found[:MOST] if _same(comparison, one[0], row)), None)
        if first is None:
            found.append((row, []))
        else:
            first[1].append(row.signal)
    return found


def _same(comparison: Comparison, one: SignalRow, other: SignalRow) -> bool:
    """Whether both are one curve in A and one in B, up to the sign and to `ALIKE` of what it runs through."""
    if one.unit != other.unit:
        return False
    here, there = comparison.curves[one.signal], comparison.curves[other.signal]
    span = max(np.ptp(here.a), np.ptp(here.b))
    pairs = [(x, np.interp(here.t, there.t, y)) for x, y in ((here.a, there.a), (here.b, there.b))]
    return any(all(rms(x - sign * y) <= ALIKE * span for x, y in pairs) for sign in (1.0, -1.0))


def _draw(above: Axes, below: Axes, row: SignalRow, curves: TubeCurves) -> None:
    unit, factor = shown(row.unit)
    t, apart = _with_breaks(curves.t)
    a, b, lower, upper = (factor * np.insert(values, apart, np.nan) for values in (curves.a, curves.b, *curves.tube))
    excess = np.insert(curves.tube.excess(curves.b), apart, 0.0)
    marker = "." if len(t) < 200 else ""
    above.fill_between(t, lower, upper, color=A_COLOUR, alpha=0.25, lw=0, label="tolerance tube")
    above.plot(t, a, color=A_COLOUR, lw=1.6, label="A")
    above.plot(t, b, color=B_COLOUR, lw=1.0, marker=marker, label="B")
    verdict = "inside"
    if row.first_exit:
        out = row.first_exit
        above.plot(out.t, factor * out.value, "o", mfc="none", color=OUT_COLOUR, ms=9, label="first out of the tube")
        verdict = f"out from {out.t:.6g} s"
    above.set_title(f"{row.signal}: {verdict}", loc="left", fontsize=10)
    above.set_ylabel(unit or "1")
    below.axhline(0.0, color=A_COLOUR, lw=1.0)
    below.plot(t, b - a, color=B_COLOUR, lw=0.9)
    below.plot(t, np.where(excess != 0.0, b - a, np.nan), color=OUT_COLOUR, lw=1.6)
    below.set(xlabel="time (s)", ylabel="B - A")
    above.tick_params(labelbottom=False)


def _tail(path: Path) -> str:
    """The end of `path` that tells files apart: its last three parts."""
    return "/".join(path.parts[-3:])


def _with_breaks(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times with one more in the middle of each gap, where lines are to break, and the indices at which they stand."""
    gaps = sampling(t).gaps if len(t) > 1 else np.empty((0, 2))
    apart = np.searchsorted(t, gaps[:, 1])
    return np.insert(t, apart, gaps.mean(axis=1)), apart
