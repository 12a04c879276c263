"""CSV files as logs: a table of numbers, and which column is which signal in which unit.

Fields are separated by commas, semicolons or tabs, whichever the head holds most of; numbers have a decimal point.
Lines before the head that start with # are comments and are kept. Every mistake is reported with its line.
"""

import codecs
import csv
import io
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import InputRefused, nearest
from twin.kernel.files import foreign_kind, open_regular
from twin.kernel.recording.logs.column_map import TIME, TIME_NAMES, MappedColumn, split_unit, unit
from twin.kernel.recording.logs.log import LARGEST, Log, LogRefused, LogSeries
from twin.kernel.units import Dimension, Unit

LARGEST_FILE = 2**30
"""Bytes; four hours of 36 columns at 200 Hz, and about as much memory."""
SEPARATORS = ",;\t"
MOST_COLUMNS = 2_000
_BLOCK = 2**20
ROWS_AT_ONCE = 200
"""Rows whose numbers are converted together, so that their texts are not all in memory."""
_TIME_DIMENSION = Dimension(s=1)


@dataclass
class WrongFields:
    """Fields of one column that are no numbers.

    Attributes:
        count: how many.
        line, text: of the first.
        texts: whether any is not empty.
        commas: whether any has a comma.
    """

    count: int = 0
    line: int = 0
    text: str = ""
    texts: bool = False
    commas: bool = False

    def add(self, line: int, text: str) -> None:
        """Take note of one."""
        if not self.count:
            self.line, self.text = line, text
        self.count += 1
        self.texts |= bool(text)
        self.commas |= "," in text


@dataclass(frozen=True)
class CsvTable:
    """A CSV file.

    Attributes:
        path: of the file.
        comments: lines before the head, without their #.
        head: names of the columns.
        values: (rows, columns); NaN where a field is no finite number.
        wrong: of the columns that have such fields, by position.
        lines: line number of each row, from 1.
    """

    path: Path
    comments: tuple[str, ...]
    head: list[str]
    values: NDArray[np.float64]
    wrong: dict[int, WrongFields]
    lines: NDArray[np.int64]

    def column(self, name: str) -> NDArray[np.float64]:
        """The numbers of the column `name`."""
        return self.values[:, self.head.index(name)]

    def mistakes(self, name: str) -> WrongFields | None:
        """What of the column `name` is no number; None: nothing."""
        return self.wrong.get(self.head.index(name))

    def is_words(self, name: str) -> bool:
        """Whether no field of the column `name` is a number, so that it says something else."""
        wrong = self.mistakes(name)
        return wrong is not None and wrong.count == len(self.values) and wrong.texts and not wrong.commas


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


def read_table(path: Path) -> CsvTable:
    """The CSV file at `path`.

    Raises:
        LogRefused: no regular file, too large, no text, no rows, rows of different lengths, in one sentence.
    """
    try:
        with open_regular(path, LARGEST_FILE) as file:
            return table_of(path, file)
    except LogRefused:
        raise
    except InputRefused as problem:
        raise LogRefused(str(problem)) from None


def table_of(path: Path, file: BinaryIO) -> CsvTable:
    """The CSV in `file`; `path` is what sentences call it. Errors as of `read_table`."""
    _refuse_foreign(path, file)
    file.seek(0)
    text = io.TextIOWrapper(file, encoding="utf-8-sig", newline="")
    comments, head, separator, rows = _head(path, text)
    values, lines, wrong = array("d"), array("q"), dict[int, WrongFields]()
    ragged, first = 0, (0, 0)
    while block := list(islice(rows, ROWS_AT_ONCE)):
        fitting = [(row, line) for row, line in block if len(row) == len(head)]
        if len(fitting) < len(block):
            first = first if ragged else next((line, len(row)) for row, line in block if len(row) != len(head))
            ragged += len(block) - len(fitting)
        if fitting:
            texts, numbers = zip(*fitting, strict=True)
            lines.extend(numbers)
            parts = [
                _numbers(column, numbers, position, wrong) for position, column in enumerate(zip(*texts, strict=True))
            ]
            values.frombytes(np.stack(parts, axis=1).tobytes())
    # so that the file stays open
    text.detach()
    if ragged:
        line, fields = first
        # 3,14 in a file separated by commas gives twice as many fields
        commas = fields > len(head) and separator == ","
        hint = "; are there decimal commas? Export with points" if commas else ""
        raise LogRefused(
            f"{path} line {line}: {fields} field{'s' * (fields > 1)}, expected {len(head)}"
            f"{_more(ragged - 1, 'row')}{hint}"
        )
    if (many := len(lines)) < 2:
        raise LogRefused(f"{path}: {many} row{'s' * (many != 1)} of numbers, expected at least 2")
    return CsvTable(
        path, comments, head, np.frombuffer(values).reshape(many, len(head)), wrong, np.frombuffer(lines, np.int64)
    )


def _refuse_foreign(path: Path, file: BinaryIO) -> None:
    """Read `file` once to see that it is text.

    Raises:
        LogRefused: it is something else, or empty.
    """
    decoder, place, empty = codecs.getincrementaldecoder("utf-8")(), 0, True
    while True:
        block = file.read(_BLOCK)
        if place == 0 and (kind := foreign_kind(block)):
            raise LogRefused(f"{path}: {kind}; expected CSV in UTF-8")
        pending = len(decoder.getstate()[0])
        try:
            decoder.decode(block, final=not block)
        except UnicodeDecodeError as problem:
            where = place - pending + problem.start
            raise LogRefused(f"{path}: byte {where} is not UTF-8; save it as CSV in UTF-8") from None
        if b"\0" in block:
            raise LogRefused(f"{path}: not a text file; expected CSV or MCAP")
        empty = empty and not block.removeprefix(codecs.BOM_UTF8).strip()
        place += len(block)
        if not block:
            break
    if empty:
        raise LogRefused(f"{path}: an empty file; expected a line of names, then rows of numbers")


def _head(path: Path, text: Iterator[str]) -> tuple[tuple[str, ...], list[str], str, Iterator[tuple[list[str], int]]]:
    """(comments, names of the columns, separator, rows after the head as `_rows` gives them) of the lines of `text`.

    Raises:
        LogRefused: there is no head, or one that names no table.
    """
    comments: list[str] = []
    before, line = 0, ""
    for line in text:
        if line.strip() and not line.startswith("#"):
            break
        before += 1
        if line.strip():
            comments.append(line.removeprefix("#").strip())
    else:
        raise LogRefused(f"{path}: only comments; expected a line of names, then rows of numbers")
    separator = max(SEPARATORS, key=line.count)
    rows = _rows(path, chain([line], text), separator, before)
    names = [name.strip() for name in next(rows)[0]]
    if len(names) > MOST_COLUMNS:
        raise LogRefused(f"{path}: {len(names):,} columns, expected at most {MOST_COLUMNS:,}")
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise LogRefused(f"{path}: two columns are named '{twice}'; expected different names")
    if all(_number(name) is not None for name in names):
        raise LogRefused(f"{path} line {before + 1}: numbers where the names of the columns are expected")
    if len(names) < 2:
        raise LogRefused(f"{path}: one column, '{names[0]}'; expected the time and at least one signal")
    return tuple(comments), names, separator, rows


def _rows(path: Path, lines: Iterator[str], separator: str, before: int) -> Iterator[tuple[list[str], int]]:
    """(fields, number of the line) of each row that is not blank; `before` lines have been read."""
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    try:
        for row in reader:
            # the first field is looked at by itself: nearly always it is the time
            if row and (row[0].strip() or any(text.strip() for text in row)):
                yield row, reader.line_num + before
    except csv.Error as problem:
        raise LogRefused(f"{path} line {reader.line_num + before}: not CSV: {problem}") from None


def _number(text: str) -> float | None:
    """The finite number that `text` spells; None if it spells none, or one that no quantity has."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) <= LARGEST else None


def _numbers(
    texts: Sequence[str], lines: Sequence[int], position: int, wrong: dict[int, WrongFields]
) -> NDArray[np.float64]:
    """The numbers that `texts` of the column at `position` spell, NaN where one does not, which `wrong` notes."""
    try:
        values = np.fromiter(map(float, texts), np.float64, len(texts))
        # nan is no number either
        if np.all(np.abs(values) <= LARGEST):
            return values
    except ValueError:
        pass
    found = [_number(text) for text in texts]
    for value, line, text in zip(found, lines, texts, strict=True):
        if value is None:
            wrong.setdefault(position, WrongFields()).add(line, text.strip())
    return np.array(found, dtype=np.float64)


def _more(others: int, what: str) -> str:
    """` (and 2 more such rows)`."""
    return f" (and {others} more such {what}{'s' * (others > 1)})" if others else ""


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
        others = _more(wrong.count - 1, "field")
        mistakes.append(f"{where}: column '{column.name}' holds {got}, expected a number{others}{hint}")
        return None
    return column.sign * factor.in_si(table.column(column.name))


def _check_times(table: CsvTable, name: str, t: NDArray[np.float64], mistakes: list[str]) -> None:
    backwards = np.flatnonzero(np.diff(t) <= 0.0) + 1
    if len(backwards):
        k = backwards[0]
        others = _more(len(backwards) - 1, "time")
        what = "repeats" if t[k] == t[k - 1] else "runs backwards from"
        mistakes.append(
            f"{table.path} line {table.lines[k]}: time '{name}' {what} {t[k - 1]:.9g} s"
            f"{'' if t[k] == t[k - 1] else f' to {t[k]:.9g} s'}, expected ascending times{others}"
        )


def _unit_of(path: Path, column: MappedColumn) -> Unit:
    return unit(column.unit or "1", f"{path}: column '{column.name}'")
