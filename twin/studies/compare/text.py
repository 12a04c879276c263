"""A comparison as text of at most 80 columns: the answer, what leaves the tube, what is nearest to it."""

import math
from collections.abc import Iterable

from twin.studies.compare.comparison import Comparison
from twin.studies.compare.row import SignalRow
from twin.studies.lines import counted, wrapped

MOST_OUTSIDE, MOST_INSIDE = 8, 6
"""Rows printed; all are in the JSON."""
SHOWN = {"m": ("mm", 1e3), "m/s": ("mm/s", 1e3), "rad": ("deg", math.degrees(1.0)), "1": ("", 1.0)}
"""Units people read, by those of recordings, and the factor."""


def comparison_text(comparison: Comparison, partial: bool = False) -> str:
    """The answer first, then the files, then signals worst first; `partial`: b may cover only a part of a."""
    lines = [_answer(comparison, partial), f"  A  {comparison.a}", f"  B  {comparison.b}{_shift(comparison)}"]
    if not comparison.identical:
        lines += ["", *_table(comparison), *_others(comparison, partial)]
    lines += [part for note in comparison.notes for part in _note(note)]
    return "\n".join(lines)


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


def _table(comparison: Comparison) -> list[str]:
    outside = [row for row in comparison.rows if row.first_exit]
    inside = [row for row in comparison.rows if not row.first_exit]
    # the one that the answer names is among them
    first = [row for row in comparison.outside[:1] if row not in outside[:MOST_OUTSIDE]]
    rows = [*outside[: MOST_OUTSIDE - len(first)], *first, *inside[:MOST_INSIDE]]
    width = max(6, *(len(row.signal) for row in rows))
    lines = [f"     {'signal':{width}} {'unit':5}{'max error':>9}{'at s':>8}{'rms':>9}{'mean':>10}{'of tube':>8}"]
    for row in rows:
        lines += _lines(row, width)
    left = [f"{len(outside) - MOST_OUTSIDE} more outside"] if len(outside) > MOST_OUTSIDE else []
    left += [f"{len(inside) - MOST_INSIDE} more inside"] if len(inside) > MOST_INSIDE else []
    return [*lines, *([f"     and {', '.join(left)}"] if left else [])]


def _lines(row: SignalRow, width: int) -> list[str]:
    unit, factor = shown(row.unit)
    numbers = f"{factor * row.max_error:9.3g}{row.max_error_at:8.3f}"
    numbers += f"{factor * row.rms_error:9.3g}{factor * row.mean_error:10.2g}"
    used = ">999 %" if row.used > 9.99 else f"{100.0 * row.used:.0f} %"
    line = f"{'OUT' if row.first_exit else 'ok':4} {row.signal:{width}} {unit:5}{numbers}{used:>8}"
    if row.first_exit is None:
        return [line]
    out = row.first_exit
    bounds = f"{factor * out.lower:.4g} .. {factor * out.upper:.4g}"
    return [line, f"       out at {out.t:.6g} s: {factor * out.value:.4g}, not in {bounds} {unit}".rstrip()]


def _others(comparison: Comparison, partial: bool) -> Iterable[str]:
    lacking, covered = comparison.least_covered
    if covered < 1.0 and not partial:
        yield from _note(f"{lacking}: what B does not cover of A is not compared; --partial lets that pass")
    for name, names in (("A", comparison.only_a), ("B", comparison.only_b)):
        if names:
            there = list(dict.fromkeys(signal.partition("[")[0] for signal in names))
            more = f" and {len(there) - 4} more" if len(there) > 4 else ""
            yield from _note(f"only in {name}: {', '.join(there[:4])}{more}")


def _note(text: str) -> list[str]:
    return wrapped(text, "  note     ", whole=True)
