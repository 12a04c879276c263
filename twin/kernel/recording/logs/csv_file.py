"""Reader of CSV files as logs: signals, units and times of the columns of a table."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import escape_controls, nearest
from twin.kernel.recording.logs.column_map import TIME_NAMES, TIME_SIGNAL, require_unit, split_unit
from twin.kernel.recording.logs.csv_table import CsvTable, more_text, read_table
from twin.kernel.recording.logs.log import Log, LogError, LogSeries, MappedColumn, NoNumbers
from twin.kernel.units import Dimension, Unit, known_unit

FORMULA_STARTS = ("=", "+", "-", "@", "\t", "\r")
"""First characters of a cell that spreadsheets read as a formula."""
TIME_DIMENSION = Dimension(s=1)
DATE_PATTERN = re.compile(
    r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}(\D.*)?|.*\d{1,2}:\d{2}.*|\d{8}T\d+.*|\d{1,2}[-/. ]+[a-z]{3,}\W+\d{2,4}.*",
    re.IGNORECASE,
)
"""Date, date with time of day, or time of day."""


def read_csv(path: Path, columns: Mapping[str, MappedColumn], known: Mapping[str, str] | None = None) -> Log:
    """Read a CSV file as a log.

    An empty field means no sample of its column in that row; NaN is an invalid sample. Unreadable columns are left out,
    and refused when they are used. Without `columns` (by signal) every numeric column is read, named as in the head.
    `known` has the unit by name of signals in the head, such as the signals of the log to compare with.
    """
    table = read_table(path)
    mistakes: list[str] = []
    sources, left_out = _sources(table, columns, known or {}, mistakes)
    t, rows, notes = np.empty(0), np.empty(0, dtype=bool), list(table.notes)
    if TIME_SIGNAL in sources:
        try:
            t, rows = _times(table, sources[TIME_SIGNAL])
        except LogError as problem:
            mistakes.append(str(problem))
    if len(rows) > len(t) > 0:
        notes.append(f"rows without a time are left out: {len(rows) - len(t)}")
    series = {}
    for name, column in sources.items():
        if name == TIME_SIGNAL:
            continue
        try:
            exported = (known or {}).get(name, "")
            # an export keeps the unit of its source, which may be unknown here
            as_is = not columns and bool(exported) and heading(name, exported) == column.name
            values, factor = _values(table, replace(column, unit="1") if as_is else column)
            if not len(t):
                continue
            values = column.sign * factor.in_si(values[rows])
            use = np.isfinite(values)
            if np.sum(use) < 2:
                some = "1 number" if np.any(use) else "no numbers"
                raise NoNumbers(f"{path}: column '{column.name}' has {some}, expected at least 2")
            # columns of the same rows share their times
            of_rows, values = (t, values) if np.all(use) else (t[use], values[use])
            wrong = table.wrong_fields(column.name)
            invalid = t[np.isin(table.lines[rows], wrong.invalid)] if wrong else t[:0]
            series[name] = LogSeries(of_rows, values, exported if as_is else factor.si, invalid)
        except LogError as problem:
            if columns and not isinstance(problem, NoNumbers):
                mistakes.append(str(problem))
            else:
                left_out[name] = str(problem)
    words = [name for name in left_out if name in table.head and table.is_words(name)]
    others = [text for name, text in left_out.items() if name not in words]
    if mistakes or (others and not series):
        raise LogError("\n".join(dict.fromkeys([*mistakes, *others])))
    if not series:
        why = "the map names no signal other than the time" if columns else "no column of numbers other than the time"
        raise LogError(f"{path}: {why}; expected at least one")
    notes += [f"columns of words are left out: {', '.join(words)}"] if words else []
    notes += [f"left out: {text.removeprefix(str(path)).strip(': ')}" for text in others]
    return Log(path, series, tuple(notes), table.comments, left_out, sources)


def _sources(
    table: CsvTable, columns: Mapping[str, MappedColumn], known: Mapping[str, str], mistakes: list[str]
) -> tuple[dict[str, MappedColumn], dict[str, str]]:
    """Select the columns to read from a CSV file, with units; also return the omitted signals with error messages."""
    sources = {}
    for signal, column in columns.items():
        # the whole name, then without unit and sign, then `Fz` for `Fz_N`
        found = [name for name in (column.text, column.name) if name in table.head][:1]
        found = found or [name for name in table.head if split_unit(name)[0] == column.name]
        if len(found) > 1:
            mistakes.append(
                f"{table.path}: column '{column.name}' for {signal} could be {' or '.join(found)}; expected one of them"
            )
        elif not found:
            hint = nearest(column.name, table.head, "it has {}")
            mistakes.append(f"{table.path}: column '{column.name}' for {signal} is not there; {hint}")
        elif found[0] == column.text:
            sources[signal] = MappedColumn(found[0], split_unit(found[0])[1])
        else:
            sources[signal] = MappedColumn(found[0], column.unit or split_unit(found[0])[1], column.sign)
    if TIME_SIGNAL not in columns:
        head = {split_unit(name)[0]: name for name in reversed(table.head)}
        time = next((head[name] for name in TIME_NAMES if name in head), None)
        if time is None:
            mistakes.append(
                f"{table.path}: no column of time; it has {', '.join(table.head)}; choose with --map time=COLUMN[UNIT]"
            )
        else:
            sources[TIME_SIGNAL] = MappedColumn(time, split_unit(time)[1])
    if columns:
        return sources, {}
    left_out: dict[str, str] = {}
    for name, (signal, of_unit) in meanings(table.head, known).items():
        if TIME_SIGNAL in sources and name == sources[TIME_SIGNAL].name:
            continue
        if table.is_words(name):
            left_out[name] = f"{table.path}: column '{name}' holds words"
        elif signal in sources or signal in left_out:
            others = [sources.pop(signal).name] if signal in sources else []
            twice = " and ".join(f"'{one}'" for one in [*others, name])
            left_out[signal] = f"{table.path}: columns {twice} are both {signal}; use --map"
        else:
            sources[signal] = MappedColumn(name, of_unit)
    return sources, left_out


def meanings(head: Sequence[str], known: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """Determine signal and unit of each column name in a CSV file's head, without empty names.

    A name that `twin export` writes for a `known` signal (unit by name) means it, then a name that equals one: `i_A` is
    not a current `i`. Every other name contains its unit, see `split_unit`.
    """
    exported: dict[str, list[tuple[str, str]]] = {}
    for signal, of_unit in known.items():
        exported.setdefault(heading(signal, of_unit), []).append((signal, of_unit))
    found = {}
    for name in head:
        signals = exported.get(name, [])
        if name:
            found[name] = signals[0] if len(signals) == 1 else split_unit(name)
    taken = {signal for signal, _ in found.values()}
    for name in found:
        if name in known and name not in taken:
            same = known_unit(split_unit(name)[1]), known_unit(known[name])
            found[name] = name, split_unit(name)[1] if same[0] and same[1] and same[0][0] == same[1][0] else "1"
    return found


def heading(name: str, of_unit: str) -> str:
    """Format the column name that `twin export` writes for a signal: `arm.tip[0]_m`, `axis/1.speed_rad_per_s`.

    Names that spreadsheets would read as a formula begin with an apostrophe.
    """
    if of_unit not in ("1", ""):
        name = f"{name}_{of_unit.replace('N m', 'Nm').replace('/', '_per_').replace(' ', '_')}"
    return f"'{escape_controls(name)}" if name.startswith(FORMULA_STARTS) else escape_controls(name)


def _values(table: CsvTable, column: MappedColumn) -> tuple[NDArray[np.float64], Unit]:
    """Return the numbers of a CSV column (n,), not finite without a sample, and its unit."""
    factor = _unit_of(table.path, column)
    values = table.column(column.name)
    wrong = table.wrong_fields(column.name)
    if wrong and wrong.texts:
        hint = "; decimal commas? Export with points" if wrong.commas else ""
        others = more_text(wrong.texts - 1, "field")
        raise LogError(
            f"{table.path} line {wrong.line}: column '{column.name}' holds '{wrong.text}', expected a number"
            f"{others}{hint}"
        )
    return values, factor


def _times(table: CsvTable, column: MappedColumn) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the times (s) of the CSV rows that have a time, ascending, and the indices of these rows."""
    wrong = table.wrong_fields(column.name)
    if wrong and DATE_PATTERN.fullmatch(wrong.text):
        raise LogError(
            f"{table.path} line {wrong.line}: time column '{column.name}' holds the date or time of day "
            f"'{wrong.text}'; expected seconds: write them to the file, counted from its first row"
        )
    factor = _unit_of(table.path, column)
    if factor.dimension != TIME_DIMENSION:
        what = f"unit '{column.unit}'" if column.unit else "no unit"
        raise LogError(f"{table.path}: time column '{column.name}' has {what}; expected s, ms, us, ns or min")
    values, factor = _values(table, column)
    rows = np.isfinite(values)
    t = column.sign * factor.in_si(values[rows])
    if len(t) < 2:
        raise LogError(
            f"{table.path}: time column '{column.name}' has {len(t)} time{'s' * (len(t) != 1)}, expected at least 2"
        )
    backwards = np.flatnonzero(np.diff(t) <= 0.0) + 1
    if len(backwards):
        k = backwards[0]
        others = more_text(len(backwards) - 1, "time")
        what = "repeats" if t[k] == t[k - 1] else "runs backwards from"
        raise LogError(
            f"{table.path} line {table.lines[rows][k]}: time '{column.name}' {what} {t[k - 1]:.9g} s"
            f"{'' if t[k] == t[k - 1] else f' to {t[k]:.9g} s'}, expected ascending times{others}"
        )
    return t, rows


def _unit_of(path: Path, column: MappedColumn) -> Unit:
    return require_unit(column.unit or "1", f"{path}: column '{column.name}'")
