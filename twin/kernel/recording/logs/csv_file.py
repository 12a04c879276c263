"""CSV files as logs: a table of numbers, and which column is which signal in which unit.

Fields are separated by commas, semicolons or tabs, whichever the head holds most of; numbers have a decimal point.
Lines before the head that start with # are comments and are kept. Every mistake is reported with its line.
"""

import codecs
import csv
import io
import os
import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import nearest, visible
from twin.kernel.files import foreign_kind, open_regular
from twin.kernel.recording.logs.column_map import TIME, TIME_NAMES, split_unit, unit
from twin.kernel.recording.logs.log import LARGEST, Log, LogRefused, LogSeries, MappedColumn, NoNumbers
from twin.kernel.units import Dimension, Unit, known_unit

FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""First characters of a cell that spreadsheets take for a formula."""
LARGEST_FILE = 2**30
"""Bytes; four hours of 36 columns at 200 Hz, and about as much memory."""
SEPARATORS = ",;\t"
MOST_COLUMNS = 2_000
_BLOCK = 2**20
ROWS_AT_ONCE = 200
"""Rows whose numbers are converted together, so that their texts are not all in memory."""
SECONDS = Dimension(s=1)
INVALID = frozenset({"null", "none", "na", "n/a", "#n/a", "<na>", "nil"})
"""Spellings of a missing number, in addition to those of NaN and infinity that float() reads."""
DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
DATE = re.compile(r"\d{1,4}[-/.]\d{1,2}[-/.]\d{1,4}(\D.*)?|\d{1,2}:\d{2}(:\d{2}.*)?")
"""A date, a date with a time of day, or a time of day."""
SEPARATOR_LINE = re.compile(r'"?sep=([^\s\w"]|\t)"?\s*', re.IGNORECASE)
"""First line of a file for Excel."""


@dataclass
class WrongFields:
    """Fields of one column that are not finite numbers.

    Attributes:
        count: number of these fields.
        line, text: the first field with other text than `INVALID`, else the first field.
        empty: number of empty fields.
        invalid: line of each field with NaN, infinity or a word of `INVALID`.
        commas: whether a field is a number with a decimal comma.
    """

    count: int = 0
    line: int = 0
    text: str = ""
    empty: int = 0
    invalid: "array[int]" = field(default_factory=lambda: array("q"))
    commas: bool = False

    @property
    def texts(self) -> int:
        """Number of fields with any other text."""
        return self.count - self.empty - len(self.invalid)

    def add(self, line: int, text: str) -> None:
        """Count one."""
        empty, invalid = not text, text.lower() in INVALID or _is_float(text)
        if not self.count or not (empty or invalid or self.texts):
            self.line, self.text = line, text
        self.count += 1
        self.empty += empty
        if invalid:
            self.invalid.append(line)
        self.commas |= bool(DECIMAL_COMMA.fullmatch(text))


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
        notes: what is missing of the file.
    """

    path: Path
    comments: tuple[str, ...]
    head: list[str]
    values: NDArray[np.float64]
    wrong: dict[int, WrongFields]
    lines: NDArray[np.int64]
    notes: tuple[str, ...] = ()

    def column(self, name: str) -> NDArray[np.float64]:
        """The numbers of the column `name`.

        Raises:
            LogRefused: two columns have that name.
        """
        if self.head.count(name) > 1:
            raise LogRefused(f"{self.path}: two columns are named '{name}'; expected different names")
        return self.values[:, self.head.index(name)]

    def mistakes(self, name: str) -> WrongFields | None:
        """What of the column `name` is no number; None: nothing."""
        return self.wrong.get(self.head.index(name))

    def is_numbers(self, name: str) -> bool:
        """Whether every field of the column `name` that has text is a number, and at least one is."""
        wrong = self.mistakes(name)
        return wrong is None or (not wrong.texts and wrong.count < len(self.values))

    def is_words(self, name: str) -> bool:
        """Whether no field of the column `name` is a number, and some are text."""
        wrong = self.mistakes(name)
        return wrong is not None and wrong.count == len(self.values) and wrong.texts > 0 and not wrong.commas


def read_csv(path: Path, columns: Mapping[str, MappedColumn], known: Mapping[str, str] | None = None) -> Log:
    """The log in the CSV file `path`.

    An empty field means that its column has no sample in that row; a field with NaN is an invalid sample. A column that
    cannot be read is left out, and refused if it is asked for.

    Args:
        columns: by signal; empty: every column that holds numbers, named as its head says.
        known: unit by name of signals that the head may name, such as those of the log to compare with.

    Raises:
        LogRefused: no text, no rows, rows of different lengths, a column of the map that is not there or cannot be
            read, times that do not ascend; every mistake of a kind, each in one sentence.
    """
    table = read_table(path)
    mistakes: list[str] = []
    sources, left_out = _sources(table, columns, known or {}, mistakes)
    t, rows, notes = np.empty(0), np.empty(0, dtype=bool), list(table.notes)
    if TIME in sources:
        try:
            t, rows = _times(table, sources[TIME])
        except LogRefused as problem:
            mistakes.append(str(problem))
    if len(rows) > len(t) > 0:
        notes.append(f"rows without a time are left out: {len(rows) - len(t)}")
    series = {}
    for name, column in sources.items():
        if name == TIME:
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
            wrong = table.mistakes(column.name)
            invalid = t[np.isin(table.lines[rows], wrong.invalid)] if wrong else t[:0]
            series[name] = LogSeries(of_rows, values, exported if as_is else factor.si, invalid)
        except LogRefused as problem:
            if columns and not isinstance(problem, NoNumbers):
                mistakes.append(str(problem))
            else:
                left_out[name] = str(problem)
    words = [name for name in left_out if name in table.head and table.is_words(name)]
    others = [text for name, text in left_out.items() if name not in words]
    if mistakes or (others and not series):
        raise LogRefused("\n".join(dict.fromkeys([*mistakes, *others])))
    if not series:
        why = "the map names no signal besides the time" if columns else "no column of numbers besides the time"
        raise LogRefused(f"{path}: {why}; expected at least one")
    notes += [f"columns of words are left out: {', '.join(words)}"] if words else []
    notes += [f"left out: {text.removeprefix(str(path)).strip(': ')}" for text in others]
    return Log(path, series, tuple(notes), table.comments, left_out, sources)


def read_table(path: Path) -> CsvTable:
    """The CSV file at `path`.

    Raises:
        InputRefused: no regular file, or too large.
        LogRefused: no text, no rows, rows of different lengths, in one sentence.
    """
    with open_regular(path, LARGEST_FILE) as file:
        return table_of(path, file)


def table_of(path: Path, file: BinaryIO) -> CsvTable:
    """The CSV in `file`; `path` is what sentences call it. Errors as of `read_table`."""
    _refuse_foreign(path, file)
    file.seek(-1, os.SEEK_END)
    ended = file.read() in (b"\n", b"\r")
    file.seek(0)
    text = io.TextIOWrapper(file, encoding="utf-8-sig", newline="")
    comments, head, separator, rows = _head(path, text)
    values, lines, wrong = array("d"), array("q"), dict[int, WrongFields]()
    ragged, first, last = 0, (0, 0), (0, 0)
    while block := list(islice(rows, ROWS_AT_ONCE)):
        fitting = [(row, line) for row, line in block if len(row) == len(head)]
        if len(fitting) < len(block):
            first = first if ragged else next((line, len(row)) for row, line in block if len(row) != len(head))
            ragged += len(block) - len(fitting)
        last = block[-1][1], len(block[-1][0])
        if fitting:
            texts, numbers = zip(*fitting, strict=True)
            lines.extend(numbers)
            parts = [
                _numbers(column, numbers, position, wrong) for position, column in enumerate(zip(*texts, strict=True))
            ]
            values.frombytes(np.stack(parts, axis=1).tobytes())
    # so that the file stays open
    text.detach()
    notes: tuple[str, ...] = ()
    end = wrong.get(len(head) - 1)
    broken = not ended and last[1] == len(head) and end is not None and (end.texts, end.line) == (1, last[0])
    if broken or (ragged == 1 and not ended and last[1] < len(head)):
        # a logger that was killed leaves half a line
        ragged, notes = 0 if not broken else ragged, (f"line {last[0]}, the last one, is cut short and left out",)
    if broken:
        del values[-len(head) :], lines[-1:], wrong[len(head) - 1]
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
    array_of_rows = np.frombuffer(values).reshape(many, len(head))
    return CsvTable(path, comments, head, array_of_rows, wrong, np.frombuffer(lines, np.int64), notes)


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
    if declared := SEPARATOR_LINE.fullmatch(line):
        separator, line, before = declared[1], next(text, ""), before + 1
    rows = _rows(path, chain([line], text), separator, before)
    names = [name.strip() for name in next(rows, ([""], 0))[0]]
    if len(names) > MOST_COLUMNS:
        raise LogRefused(f"{path}: {len(names):,} columns, expected at most {MOST_COLUMNS:,}")
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


def _is_float(text: str) -> bool:
    """Whether `text` spells a number for Python, also NaN, infinity or one that no quantity has."""
    try:
        float(text)
    except ValueError:
        return False
    return True


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
    table: CsvTable, columns: Mapping[str, MappedColumn], known: Mapping[str, str], mistakes: list[str]
) -> tuple[dict[str, MappedColumn], dict[str, str]]:
    """The columns to read, each with its unit; and signals that are left out -> error message."""
    sources = {}
    for signal, column in columns.items():
        # the whole name as it is written, then without unit and sign, then `Fz` finds `Fz_N`, too
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
    if TIME not in columns:
        head = {split_unit(name)[0]: name for name in reversed(table.head)}
        time = next((head[name] for name in TIME_NAMES if name in head), None)
        if time is None:
            mistakes.append(
                f"{table.path}: no column of time; it has {', '.join(table.head)}; choose with --map time=COLUMN[UNIT]"
            )
        else:
            sources[TIME] = MappedColumn(time, split_unit(time)[1])
    if columns:
        return sources, {}
    left_out: dict[str, str] = {}
    for name, (signal, of_unit) in meanings(table.head, known).items():
        if TIME in sources and name == sources[TIME].name:
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
    """Return the signal and unit of each name of the head; empty names are skipped.

    A name that `twin export` writes for one of the `known` signals (unit by name) means it, then a name that is one of
    them as a whole: `i_A` is then no current `i`. Every other name carries its unit, as `split_unit` has it.
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
    """The name of a column in a CSV file of `twin export`: `plant.p_B[0]_m`, `drive/1.omega_m_rad_per_s`.

    A name that spreadsheets would take for a formula begins with an apostrophe.
    """
    if of_unit != "1":
        name = f"{name}_{of_unit.replace('N m', 'Nm').replace('/', '_per_').replace(' ', '_')}"
    return f"'{visible(name)}" if name.startswith(FORMULA) else visible(name)


def _values(table: CsvTable, column: MappedColumn) -> tuple[NDArray[np.float64], Unit]:
    """Numbers of a column (n,), not finite where it has no sample, and its unit."""
    factor = _unit_of(table.path, column)
    values = table.column(column.name)
    wrong = table.mistakes(column.name)
    if wrong and wrong.texts:
        hint = "; decimal commas? Export with points" if wrong.commas else ""
        others = _more(wrong.texts - 1, "field")
        raise LogRefused(
            f"{table.path} line {wrong.line}: column '{column.name}' holds '{wrong.text}', expected a number"
            f"{others}{hint}"
        )
    return values, factor


def _times(table: CsvTable, column: MappedColumn) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Times (s) of the rows that have one, ascending, and which rows these are."""
    wrong = table.mistakes(column.name)
    if wrong and DATE.fullmatch(wrong.text):
        raise LogRefused(
            f"{table.path} line {wrong.line}: time column '{column.name}' holds the date or time of day "
            f"'{wrong.text}'; expected seconds: write them to the file, counted from its first row"
        )
    factor = _unit_of(table.path, column)
    if factor.dimension != SECONDS:
        what = f"unit '{column.unit}'" if column.unit else "no unit"
        raise LogRefused(f"{table.path}: time column '{column.name}' has {what}; expected s, ms, us, ns or min")
    values, factor = _values(table, column)
    rows = np.isfinite(values)
    t = column.sign * factor.in_si(values[rows])
    if len(t) < 2:
        raise LogRefused(
            f"{table.path}: time column '{column.name}' has {len(t)} time{'s' * (len(t) != 1)}, expected at least 2"
        )
    _check_times(table, column.name, t, table.lines[rows])
    return t, rows


def _check_times(table: CsvTable, name: str, t: NDArray[np.float64], lines: NDArray[np.int64]) -> None:
    backwards = np.flatnonzero(np.diff(t) <= 0.0) + 1
    if len(backwards):
        k = backwards[0]
        others = _more(len(backwards) - 1, "time")
        what = "repeats" if t[k] == t[k - 1] else "runs backwards from"
        raise LogRefused(
            f"{table.path} line {lines[k]}: time '{name}' {what} {t[k - 1]:.9g} s"
            f"{'' if t[k] == t[k - 1] else f' to {t[k]:.9g} s'}, expected ascending times{others}"
        )


def _unit_of(path: Path, column: MappedColumn) -> Unit:
    return unit(column.unit or "1", f"{path}: column '{column.name}'")
