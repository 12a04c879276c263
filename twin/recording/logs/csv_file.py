"""CSV files as logs: which column is which signal, in which unit; every mistake with its line."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.errors import nearest
from twin.recording.logs.column_map import TIME, TIME_NAMES, MappedColumn, split_unit
from twin.recording.logs.csv_table import CsvTable, more, read_table
from twin.recording.logs.errors import LogRefused
from twin.recording.logs.log import Log, LogSeries
from twin.recording.logs.units import unit
from twin.units import Dimension, Unit

_TIME_DIMENSION = Dimension(s=1)


def read_csv(path: Path, columns: Mapping[str, MappedColumn]) -> Log:
    """The log in the CSV file `path`.

    Args:
        columns: by signal; empty: every column that holds numbers, named as its head says.

    Raises:
        LogRefused: no text, no rows, rows of different lengths, a column that is not there, a unit that is none, a
            field that is no finite number, times that do not ascend; every mistake of a kind, each in one sentence.
    """
    table = read_table(path)
    mistakes: list[str] = []
    sources, notes = _sources(table, columns, mistakes)
    t = _values(table, TIME, sources[TIME], mistakes) if TIME in sources else None
    if t is not None:
        _check_times(table, sources[TIME].name, t, mistakes)
    series = {}
    for name, column in sources.items():
        if name != TIME:
            values = _values(table, name, column, mistakes)
            if t is not None and values is not None:
                series[name] = LogSeries(t, values, _unit_of(table.path, column).si)
    if mistakes:
        raise LogRefused("\n".join(mistakes))
    if not series:
        why = "the map names no signal besides the time" if columns else "no column of numbers besides the time"
        raise LogRefused(f"{path}: {why}; expected at least one")
    return Log(path, series, notes, table.comments)


def _sources(
    table: CsvTable, columns: Mapping[str, MappedColumn], mistakes: list[str]
) -> tuple[dict[str, MappedColumn], tuple[str, ...]]:
    """The columns to read, each with its unit; and what is left out."""
    head = {split_unit(name)[0]: name for name in reversed(table.head)}
    sources = {}
    for signal, column in columns.items():
        # `Fz` finds `Fz_N`, too
        name = column.name if column.name in table.head else head.get(column.name)
        if name is None:
            hint = nearest(column.name, table.head, "it has {}")
            mistakes.append(f"{table.path}: column '{column.name}' for {signal} is not there; {hint}")
        else:
            sources[signal] = MappedColumn(name, column.unit or split_unit(name)[1], column.sign)
    if TIME not in columns:
        time = next((head[name] for name in TIME_NAMES if name in head), None)
        if time is None:
            mistakes.append(
                f"{table.path}: no column of time; it has {', '.join(table.head)}; choose with --map time=COLUMN[UNIT]"
            )
        else:
            sources[TIME] = MappedColumn(time, split_unit(time)[1])
    if columns:
        return sources, ()
    words = []
    for name in table.head:
        if TIME in sources and name == sources[TIME].name:
            continue
        if table.is_words(name):
            words.append(name)
        elif (signal := split_unit(name)[0]) in sources:
            mistakes.append(f"{table.path}: columns '{sources[signal].name}' and '{name}' are both {signal}; use --map")
        else:
            sources[signal] = MappedColumn(name, split_unit(name)[1])
    return sources, (f"columns of words are left out: {', '.join(words)}",) if words else ()


def _values(table: CsvTable, signal: str, column: MappedColumn, mistakes: list[str]) -> NDArray[np.float64] | None:
    """A column in SI (n,); None after adding what is wrong to `mistakes`."""
    try:
        factor = _unit_of(table.path, column)
    except LogRefused as problem:
        mistakes.append(str(problem))
        return None
    if signal == TIME and factor.dimension != _TIME_DIMENSION:
        what = f"unit '{column.unit}'" if column.unit else "no unit"
        mistakes.append(f"{table.path}: time column '{column.name}' has {what}; expected s, ms, us, ns or min")
        return None
    if wrong := table.mistakes(column.name):
        got = f"'{wrong.text}'" if wrong.text else "nothing"
        hint = "; decimal commas? Export with points" if wrong.text.count(",") == 1 else ""
        where = f"{table.path} line {wrong.line}"
        others = more(wrong.count - 1, "field")
        mistakes.append(f"{where}: column '{column.name}' holds {got}, expected a number{others}{hint}")
        return None
    return column.sign * factor.in_si(table.column(column.name))


def _check_times(table: CsvTable, name: str, t: NDArray[np.float64], mistakes: list[str]) -> None:
    backwards = np.flatnonzero(np.diff(t) <= 0.0) + 1
    if len(backwards):
        k = backwards[0]
        others = more(len(backwards) - 1, "time")
        what = "repeats" if t[k] == t[k - 1] else "runs backwards from"
        mistakes.append(
            f"{table.path} line {table.lines[k]}: time '{name}' {what} {t[k - 1]:.9g} s"
            f"{'' if t[k] == t[k - 1] else f' to {t[k]:.9g} s'}, expected ascending times{others}"
        )


def _unit_of(path: Path, column: MappedColumn) -> Unit:
    return unit(column.unit or "1", f"{path}: column '{column.name}'")
