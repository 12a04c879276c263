"""Text of a comparison, at most 80 columns wide, the answer first."""

import math
from collections.abc import Iterable, Sequence

from twin.kernel.serialise import to_dict
from twin.studies.compare.comparison import Comparison, Differences
from twin.studies.compare.signal_row import SignalRow
from twin.studies.compare.tolerance import some_signals
from twin.studies.result import Block, Cell, Column, Note, Result, Table, count_text, shorten

MAX_DIFFERENCES = 8
"""Maximum number of differences in the text; the JSON contains all."""
MAX_VALUE_LENGTH = 24
"""Maximum length of a value in the text (characters)."""
MAX_OUTSIDE_ROWS, MAX_INSIDE_ROWS = 8, 6
"""Maximum numbers of printed rows outside and inside their tubes; the JSON contains all."""
SIGNAL_COLUMNS = (
    Column("", 4, left=True),
    Column("signal", left=True),
    Column("unit", 5, left=True),
    Column("max error", 9, ".3g", gap=0),
    Column("at s", 8, ".3f", gap=0),
    Column("rms", 9, ".3g", gap=0),
    Column("mean", 10, ".2g", gap=0),
    Column("of tube", 8, gap=0),
)
DISPLAY_UNITS = {"m": ("mm", 1e3), "m/s": ("mm/s", 1e3), "rad": ("deg", math.degrees(1.0)), "1": ("", 1.0)}
"""SI unit -> displayed unit and the factor to it."""


def differences_lines(differences: Differences | None) -> list[Note | str]:
    """Return the lines of a comparison's report about differences between the experiments; empty if unknown."""
    if differences is None:
        return []
    if not differences:
        return ["", "Nothing differs in the experiments."]
    lines = [
        Note(" and ".join(shorten(value, MAX_VALUE_LENGTH) for value in values), f"  {key}  ", later=6, whole=True)
        for key, values in list(differences.items())[:MAX_DIFFERENCES]
    ]
    more = len(differences) - MAX_DIFFERENCES
    rest = [f"  and {count_text(more, 'more value')}"] if more > 0 else []
    return ["", "Differences of the experiments, A and B:", *lines, *rest]


def comparison_result(comparison: Comparison, partial: bool = False, differences: Differences | None = None) -> Result:
    """Return the report of a comparison: answer, files, signals worst first, differences of the experiments."""
    covered = partial or comparison.least_coverage[1] == 1.0
    shift = f", shifted by {comparison.shift.seconds:+.6g} s" if comparison.shift.seconds else ""
    parts = [
        f"  A  {comparison.a}",
        f"  B  {comparison.b}{shift}",
        *(["", *_tables(comparison), *_others(comparison, partial)] if not comparison.identical else []),
        *map(_note, comparison.notes),
        *differences_lines(differences),
    ]
    facts = to_dict(comparison) | {"experiments": differences}
    common = len(comparison.rows) + len(comparison.disjoint)
    share = f"{common} of {comparison.most} signals in common: " if common < comparison.most else ""
    answer = Note(share + _answer(comparison, partial), later=2, whole=True)
    return Result(answer, parts, facts, exit_code=0 if covered and not comparison.outside_rows else 1)


def display_unit(unit: str) -> tuple[str, float]:
    return DISPLAY_UNITS.get(unit, (unit, 1.0))


def _answer(comparison: Comparison, partial: bool) -> str:
    count = len(comparison.rows)
    if comparison.identical:
        return f"B is identical to A: the same bytes, {count} signals"
    _, covered = comparison.least_coverage
    # round down, so that less than all never reads as 100 %
    of_a = "all" if covered == 1.0 else f"{min(100.0 * covered, 99.9):.3g} %"
    if not comparison.outside_rows and covered < 1.0 and not partial:
        return f"B covers only {of_a} of A's time, within the tolerance tube there"
    if not comparison.outside_rows:
        return f"B stays within the tolerance tube of A: {count_text(count, 'signal')}, {of_a} of A's time"
    first = comparison.outside_rows[0]
    when = first.first_exit.t if first.first_exit else math.nan
    left = f"{len(comparison.outside_rows)} of {count_text(count, 'signal')} {'leaves' if count == 1 else 'leave'}"
    return f"{left} the tube around A (first: {first.signal}, at {when:.6g} s), compared over {of_a} of A"


def _tables(comparison: Comparison) -> list[Block]:
    outside = [row for row in comparison.rows if row.first_exit]
    inside = [row for row in comparison.rows if not row.first_exit]
    # the signal that the answer names is always shown
    first = [row for row in comparison.outside_rows[:1] if row not in outside[:MAX_OUTSIDE_ROWS]]
    rows = [*outside[: MAX_OUTSIDE_ROWS - len(first)], *first, *inside[:MAX_INSIDE_ROWS]]
    left = [
        f"{len(found) - most} more {where}"
        for found, most, where in ((outside, MAX_OUTSIDE_ROWS, "outside"), (inside, MAX_INSIDE_ROWS, "inside"))
        if len(found) > most
    ]
    table = Table(SIGNAL_COLUMNS, [cells for row in rows for cells in _rows(row)], indent=0)
    return [table, *([f"     and {', '.join(left)}"] if left else [])]


def _rows(row: SignalRow) -> list[Sequence[Cell] | str]:
    unit, factor = display_unit(row.unit)
    used = ">999 %" if row.used > 9.99 else f"{100.0 * row.used:.0f} %"
    errors = (factor * row.max_error, row.max_error_at, factor * row.rms_error, factor * row.mean_error)
    line = ("OUT" if row.first_exit else "ok", row.signal, unit, *errors, used)
    if row.first_exit is None:
        return [line]
    out = row.first_exit
    bounds = f"{factor * out.lower:.4g} .. {factor * out.upper:.4g}"
    return [line, f"       out at {out.t:.6g} s: {factor * out.value:.4g}, not in {bounds} {unit}"]


def _others(comparison: Comparison, partial: bool) -> Iterable[Block]:
    lacking, covered = comparison.least_coverage
    if covered < 1.0 and not partial:
        yield _note(f"{lacking}: B covers only a part of A; --partial accepts that")
    for name, names in (("A", comparison.only_a), ("B", comparison.only_b)):
        if names:
            yield _note(f"only in {name}: {some_signals(names, 4)}")


def _note(text: str) -> Note:
    return Note(text, "  note     ", whole=True)
