"""A comparison as text of at most 80 columns and as a picture: the answer first."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from twin.kernel.recording.logs.log import sampling
from twin.studies.compare.comparison import Comparison, Differences, SignalRow, TubeCurves, differences_lines
from twin.studies.figure import PAPER_BLUE, PAPER_ORANGE, Axes, picture
from twin.studies.lines import counted
from twin.studies.metrics.response import rms
from twin.studies.result import Block, Cell, Column, Note, Result, Table

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
    """The answer first, then the files, then signals worst first, then what differs in the experiments.

    Args:
        partial: whether b may cover only a part of a.
        differences: of the experiments; None: they are not compared.
    """
    covered = partial or comparison.least_covered[1] == 1.0
    parts = [
        f"  A  {comparison.a}",
        f"  B  {comparison.b}{_shift(comparison)}",
        *(["", *_tables(comparison), *_others(comparison, partial)] if not comparison.identical else []),
        *map(_note, comparison.notes),
        *differences_lines(differences),
    ]
    facts = comparison.facts() | {"experiments": differences}
    return Result(_answer(comparison, partial), parts, facts, exit_code=0 if covered and not comparison.outside else 1)


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
    left = f"{len(comparison.outside)} of {count}"
    return f"{left} leave the tube: {first.signal} first, at {when:.6g} s; {of_a} of A"


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
            there = list(dict.fromkeys(signal.partition("[")[0] for signal in names))
            more = f" and {len(there) - 4} more" if len(there) > 4 else ""
            yield _note(f"only in {name}: {', '.join(there[:4])}{more}")


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
                more = f" and {len(alike) - NAMED} more" if len(alike) > NAMED else ""
                above.set_title(f"as {', '.join(alike[:NAMED])}{more}", loc="right", fontsize=8)
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
