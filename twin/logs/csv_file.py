"""CSV files: a head of names, then numbers; every mistake with its line.

Fields are separated by commas, semicolons or tabs, whichever the head holds most of; numbers have a decimal point.
Lines before the head that start with # are comments and are kept.
"""

import csv
import difflib
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.logs.column_map import TIME, TIME_NAMES, Column, split_unit
from twin.logs.errors import LogRefused
from twin.logs.log import Log, Series
from twin.logs.units import Dimension, Unit, unit

SEPARATORS = ",;\t"
_TIME_DIMENSION = Dimension(s=1)


class Table(NamedTuple):
    """A CSV file as text.

    Attributes:
        path: of the file.
        comments: lines before the head, without their #.
        head: names of the columns.
        rows: the fields of each row; as many as the head has.
        lines: line number of each row, from 1.
    """

    path: Path
    comments: tuple[str, ...]
    head: list[str]
    rows: list[list[str]]
    lines: list[int]

    def column(self, name: str) -> list[str]:
        """The fields of the column `name`."""
        index = self.head.index(name)
        return [row[index] for row in self.rows]


def read_csv(path: Path, columns: Mapping[str, Column]) -> Log:
    """The log in the CSV file `path`.

    Args:
        path: of the file.
        columns: by signal; empty: every column that holds numbers, named as its head says.

    Raises:
        LogRefused: no text, no rows, rows of different lengths, a column that is not there, a unit that is none, a
            field that is no finite number, times that do not ascend; every mistake of a kind, each in one sentence.
    """
    table = _table(path)
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
                series[name] = Series(t, values, _unit_of(table.path, column).si)
    if mistakes:
        raise LogRefused("\n".join(mistakes))
    return Log(path, series, notes, table.comments)


def _table(path: Path) -> Table:
    try:
        content = path.read_bytes()
    except OSError as problem:
        raise LogRefused(f"{path}: cannot be read: {problem.strerror}") from None
    if not content.strip():
        raise LogRefused(f"{path}: an empty file; expected a line of names, then rows of numbers")
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise LogRefused(f"{path}: byte {problem.start} is not UTF-8; save it as CSV in UTF-8") from None
    if "\0" in text:
        raise LogRefused(f"{path}: not a text file; expected CSV or MCAP")
    lines = text.splitlines()
    first = next((i for i, line in enumerate(lines) if line.strip() and not line.startswith("#")), len(lines))
    comments = tuple(line.removeprefix("#").strip() for line in lines[:first] if line.strip())
    if first == len(lines):
        raise LogRefused(f"{path}: only comments; expected a line of names, then rows of numbers")
    separator = max(SEPARATORS, key=lines[first].count)
    reader = csv.reader(lines[first:], delimiter=separator, skipinitialspace=True)
    try:
        numbered = [(reader.line_num + first, [field.strip() for field in row]) for row in reader if row]
    except csv.Error as problem:
        raise LogRefused(f"{path} line {reader.line_num + first}: not CSV: {problem}") from None
    head = numbered[0][1]
    rows = [(line, row) for line, row in numbered[1:] if any(row)]
    if len(set(head)) < len(head):
        twice = next(name for name in head if head.count(name) > 1)
        raise LogRefused(f"{path}: two columns are named '{twice}'; expected different names")
    if all(_number(field) is not None for field in head):
        raise LogRefused(f"{path} line {first + 1}: numbers where the names of the columns are expected")
    if len(head) < 2:
        raise LogRefused(f"{path}: one column, '{head[0]}'; expected the time and at least one signal")
    ragged = [(line, len(row)) for line, row in rows if len(row) != len(head)]
    if ragged:
        line, count = ragged[0]
        # 3,14 in a file separated by commas gives twice as many fields
        hint = "; are there decimal commas? Export with points" if count > len(head) and separator == "," else ""
        raise LogRefused(
            f"{path} line {line}: {count} field{'s' * (count > 1)}, expected {len(head)}{_more(ragged, 'row')}{hint}"
        )
    if len(rows) < 2:
        raise LogRefused(f"{path}: {len(rows)} row{'s' * (len(rows) != 1)} of numbers, expected at least 2")
    return Table(path, comments, head, [row for _, row in rows], [line for line, _ in rows])


def _sources(
    table: Table, columns: Mapping[str, Column], mistakes: list[str]
) -> tuple[dict[str, Column], tuple[str, ...]]:
    """The columns to read, each with its unit; and what is left out."""
    head = {split_unit(name)[0]: name for name in reversed(table.head)}
    sources = {}
    for signal, column in columns.items():
        # `Fz` finds `Fz_N`, too
        name = column.name if column.name in table.head else head.get(column.name)
        if name is None:
            close = difflib.get_close_matches(column.name, table.head, 1, cutoff=0.5)
            hint = f"did you mean '{close[0]}'?" if close else f"it has {', '.join(table.head)}"
            mistakes.append(f"{table.path}: column '{column.name}' for {signal} is not there; {hint}")
        else:
            sources[signal] = Column(name, column.unit or split_unit(name)[1], column.sign)
    if TIME not in columns:
        time = next((head[name] for name in TIME_NAMES if name in head), None)
        if time is None:
            mistakes.append(
                f"{table.path}: no column of time; it has {', '.join(table.head)}; choose with --map time=COLUMN[UNIT]"
            )
        else:
            sources[TIME] = Column(time, split_unit(time)[1])
    if columns:
        return sources, ()
    words = []
    for name in table.head:
        if TIME in sources and name == sources[TIME].name:
            continue
        if _is_words(table.column(name)):
            words.append(name)
        elif (signal := split_unit(name)[0]) in sources:
            mistakes.append(f"{table.path}: columns '{sources[signal].name}' and '{name}' are both {signal}; use --map")
        else:
            sources[signal] = Column(name, split_unit(name)[1])
    return sources, (f"columns of words are left out: {', '.join(words)}",) if words else ()


def _is_words(fields: Sequence[str]) -> bool:
    """Whether no field of a column is a number, so that it says something else."""
    return all(_number(field) is None and "," not in field for field in fields) and any(fields)


def _values(table: Table, signal: str, column: Column, mistakes: list[str]) -> NDArray[np.float64] | None:
    """A column in SI (n,); None after adding what is wrong to `mistakes`."""
    fields = table.column(column.name)
    try:
        factor = _unit_of(table.path, column)
    except LogRefused as problem:
        mistakes.append(str(problem))
        return None
    if signal == TIME and factor.dimension != _TIME_DIMENSION:
        what = f"unit '{column.unit}'" if column.unit else "no unit"
        mistakes.append(f"{table.path}: time column '{column.name}' has {what}; expected s, ms, us, ns or min")
        return None
    try:
        values = np.array(fields, dtype=np.float64)
    except ValueError:
        values = np.array([_number(field) or 0.0 if _number(field) is not None else np.nan for field in fields])
    wrong = np.flatnonzero(~np.isfinite(values))
    if len(wrong):
        field = fields[wrong[0]]
        got = f"'{field}'" if field else "nothing"
        hint = "; decimal commas? Export with points" if field.count(",") == 1 else ""
        where = f"{table.path} line {table.lines[wrong[0]]}"
        mistakes.append(f"{where}: column '{column.name}' holds {got}, expected a number{_more(wrong, 'field')}{hint}")
        return None
    return column.sign * factor.in_si(values)


def _check_times(table: Table, name: str, t: NDArray[np.float64], mistakes: list[str]) -> None:
    backwards = np.flatnonzero(np.diff(t) <= 0.0) + 1
    if len(backwards):
        k = backwards[0]
        what = "repeats" if t[k] == t[k - 1] else "runs backwards from"
        mistakes.append(
            f"{table.path} line {table.lines[k]}: time '{name}' {what} {t[k - 1]:.9g} s"
            f"{'' if t[k] == t[k - 1] else f' to {t[k]:.9g} s'}, expected ascending times{_more(backwards, 'time')}"
        )


def _unit_of(path: Path, column: Column) -> Unit:
    return unit(column.unit or "1", f"{path}: column '{column.name}'")


def _number(field: str) -> float | None:
    try:
        value = float(field)
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _more(found: Sequence | NDArray, what: str) -> str:
    others = len(found) - 1
    return f" (and {others} more such {what}{'s' * (others > 1)})" if others else ""
