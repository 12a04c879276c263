"""Text of at most 80 columns and pictures of the checks of `twin check`."""

from collections import Counter
from collections.abc import Sequence
from math import nan
from pathlib import Path

import numpy as np

from twin.kernel.atomic_write import make_folder
from twin.studies.check.verdict import CheckRow, CheckVerdict, TubeDeparture
from twin.studies.compare.picture import A_COLOUR, B_COLOUR, OUT_COLOUR
from twin.studies.compare.text import display_unit
from twin.studies.figure import Axes, picture
from twin.studies.result import Block, Column, Note, Result, Row, Table, count_text

MAX_NAME_LENGTH = 33
"""Maximum length of names next to their numbers; longer names have a line of their own."""
METRIC_COLUMNS = (
    Column("", 7, left=True),
    Column("metric", left=True),
    Column("unit", 6, left=True),
    Column("baseline", 10, ".4g", gap=0),
    Column("now", 10, ".4g", gap=0),
    Column("bound", 10, ".4g", gap=0),
)
MAX_SHOWN = 5
"""Maximum number of deviating checks shown in full; the others have one line each, and the JSON contains all."""


def check_result(verdicts: Sequence[CheckVerdict], failures: Sequence[str]) -> Result:
    """Return the report of regression checks: every number of a single check, only the deviations of several."""
    parts: list[Block] = []
    shown = verdicts if len(verdicts) == 1 else [verdict for verdict in verdicts if verdict.deviations]
    shown = [verdict for verdict in shown if len(verdicts) == 1 or not _is_new(verdict)]
    for verdict in shown[:MAX_SHOWN]:
        rows = verdict.rows if len(verdicts) == 1 else verdict.deviations
        parts += [
            "",
            f"{verdict.experiment}, {verdict.drive}",
            Table(METRIC_COLUMNS, [row for one in rows for row in _rows(one)]),
        ]
        as_it_was = len(verdict.rows) - len(rows)
        parts += [f"  and {as_it_was} as they were"] if as_it_was else []
        parts += [line for note in verdict.notes for line in _label_lines("note", note)]
    parts += [""] * (len(shown) > MAX_SHOWN)
    parts += [f"{verdict.experiment}, {verdict.drive}: {_words([verdict])}" for verdict in shown[MAX_SHOWN:]]
    # show notes shared by many checks once
    others = Counter(note for verdict in verdicts if verdict not in shown[:MAX_SHOWN] for note in verdict.notes)
    parts += [""] * bool(others)
    for note, count in others.items():
        parts += _label_lines("note", f"{note} ({count} checks)" if count > 1 else note)
    parts += [""] * bool(failures)
    parts += [line for failure in dict.fromkeys(failures) for line in _label_lines("not done", failure)]
    return Result(_answer(verdicts, failures), parts)


def _answer(verdicts: Sequence[CheckVerdict], failures: Sequence[str]) -> str:
    missed = f"{count_text(len(failures), 'check')} could not be done" if failures else ""
    if not verdicts:
        return missed
    experiments, drives = {v.experiment for v in verdicts}, {v.drive for v in verdicts}
    rows = sum(len(verdict.rows) for verdict in verdicts)
    of = f"{count_text(len(experiments), 'experiment')}, {count_text(len(drives), 'drive')}, {rows} numbers and curves"
    first = [verdict for verdict in verdicts if _is_new(verdict)]
    wrong = [verdict for verdict in verdicts if verdict.deviations and verdict not in first]
    added = f"{count_text(len(first), 'check')} without a baseline until now" if first else ""
    if len(first) == len(verdicts):
        return "; ".join(filter(None, (f"New: {of}", missed)))
    if not wrong:
        return "\n  ".join(filter(None, (f"All as it was: {of}", added, missed)))
    share = f"{len(wrong)} of {count_text(len(verdicts), 'check')} {'deviates' if len(wrong) == 1 else 'deviate'}"
    head = f"{share if len(verdicts) > 1 else 'Deviates'}: {_words(wrong)}"
    return "\n  ".join(filter(None, (head, f"of {of}", added, missed)))


def _words(verdicts: Sequence[CheckVerdict]) -> str:
    """Return the counts of all verdicts as text, such as `3 worse, 1 outside`."""
    words = Counter(row.word for verdict in verdicts for row in verdict.deviations)
    return ", ".join(f"{count} {word}" for word, count in words.most_common())


def _is_new(verdict: CheckVerdict) -> bool:
    return all(row.word == "new" for row in verdict.rows)


def _rows(row: CheckRow) -> list[Row]:
    unit, factor = display_unit(row.unit)
    numbers = [nan if value is None else factor * value for value in (row.before, row.now, row.bound)]
    name = row.name if row.at is None or row.word == "ok" else f"{row.name} at {row.at:.4g} s"
    if len(name) > MAX_NAME_LENGTH:
        return [f"  {row.word:7} {name}", ("", "", unit, *numbers)]
    return [(row.word, name, unit, *numbers)]


def _label_lines(label: str, text: str) -> list[Note]:
    first, *others = text.splitlines()
    return [Note(first, f"  {label:9}", whole=True), *(Note(line, " " * 11, whole=True) for line in others)]


def check_pictures(verdicts: Sequence[CheckVerdict], folder: Path) -> list[Path]:
    """Draw the first `MAX_SHOWN` checks with curves outside their tubes to PNG files; return their paths."""
    drawn = []
    make_folder(folder)
    for verdict in [verdict for verdict in verdicts if verdict.outside][:MAX_SHOWN]:
        path = folder / f"{verdict.experiment}_{Path(verdict.drive).stem}.png"
        drawn.append(path)
        with picture(path, 8.0, 3.2 * len(verdict.outside) + 0.5) as figure:
            panels = figure.subplots(len(verdict.outside), squeeze=False)[:, 0]
            for axes, curve in zip(panels, verdict.outside, strict=True):
                _draw(axes, curve)
            panels[-1].set_xlabel("time (s)")
            figure.suptitle(f"{verdict.experiment}, {verdict.drive}", fontsize=11)
            figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=9)
    return drawn


def _draw(axes: Axes, curve: TubeDeparture) -> None:
    unit, factor = display_unit(curve.unit)
    t = np.array(curve.t)
    before, lower, upper, now = (
        factor * np.array(line) for line in (curve.before, curve.lower, curve.upper, curve.now)
    )
    out = (now < lower) | (now > upper)
    axes.fill_between(t, lower, upper, color=A_COLOUR, alpha=0.25, lw=0, label="tolerance tube")
    axes.plot(t, before, color=A_COLOUR, lw=1.6, label="baseline")
    axes.plot(t, now, color=B_COLOUR, lw=1.0, marker=".", label="now")
    axes.plot(t[out], now[out], "o", mfc="none", color=OUT_COLOUR, ms=7, label="outside")
    axes.set_title(f"{curve.name}: {curve.signal}", loc="left", fontsize=10)
    axes.set_ylabel(unit or "1")
