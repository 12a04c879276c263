"""CSV files as logs: a table of numbers, and which column is which signal in which unit.

Fields are separated by commas, semicolons or tabs, whichever the head holds most of; numbers have a decimal point.
Lines before the head that start with # are comments and are kept. Every mistake is reported with its line.

For a robot's CSV file a map of its columns is proposed, by names, units and values. What the file leaves no doubt about
stands in it as it is; what is in doubt stands in it as comments.
"""

import codecs
import csv
import io
import json
import os
import re
from array import array
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice
from pathlib import Path
from typing import BinaryIO, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin.kernel.errors import nearest, visible
from twin.kernel.files import foreign_kind, open_regular
from twin.kernel.recording.logs.column_map import TIME, TIME_NAMES, MappedColumn, split_unit, unit
from twin.kernel.recording.logs.log import LARGEST, Log, LogRefused, LogSeries
from twin.kernel.units import FORCE, Dimension, Unit, known_unit
from twin.kernel.writing import write_text

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
        InputRefused: no regular file, or too large.
        LogRefused: no text, no rows, rows of different lengths, in one sentence.
    """
    with open_regular(path, LARGEST_FILE) as file:
        return table_of(path, file)


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


ANGLE, SECONDS, MASS = Dimension(rad=1), Dimension(s=1), Dimension(kg=1)
SIDES = {"m": ("m", "mot", "motor", "motors"), "l": ("l", "link", "joint", "load", "arm", "out", "output")}
"""Side of the spring, as in `theta_m` and `theta_l` -> words by which columns name it."""
FORCES = ("f", "fz", "force", "scale", "load", "loadcell", "weight")
CLOCKS = (*TIME_NAMES, "stamp", "clock")
LAST = "F_z"


class Triple(NamedTuple):
    """Three columns that differ in a number from 0 to 2 or from 1 to 3.

    Attributes:
        columns: by joint.
        words: of their common name, small letters.
        unit: as their names carry it; "" if they do not.
        counts: whether they hold whole numbers only, without a unit.
    """

    columns: tuple[str, str, str]
    words: frozenset[str]
    unit: str
    counts: bool


class Proposal(NamedTuple):
    """A map that has been written, and whether it is complete as it is."""

    path: Path
    complete: bool


def propose(log: Path) -> Proposal:
    """Write the column map of the CSV file `log` beside it, as NAME.map.toml.

    Raises:
        LogRefused: no CSV file, or the map is there already.
        NotWritten: the folder or the disk refuses.
    """
    text, complete = proposal(read_table(log))
    path = log.with_suffix(".map.toml")
    if os.path.lexists(path):
        raise LogRefused(f"{path}: is there already and is not touched; remove or rename it for a new one")
    write_text(path, text)
    return Proposal(path, complete)


def proposal(table: CsvTable) -> tuple[str, bool]:
    """(text of the map, whether nothing in it is in doubt)."""
    numbers = [name for name in table.head if not table.mistakes(name)]
    sections = [_time(table, numbers), *_angles(table, numbers), _force(table, numbers)]
    taken = {name for lines in sections for name in numbers if any(_quoted(name) in line for line in lines)}
    lines = [f"# Which column of {visible(table.path.name)} is which signal, for twin replay and twin identify."]
    lines.append("# Angles: positive where the link goes down, zero with it horizontal; the motor's before the belt.")
    for section in sections:
        lines += ["", *section]
    if left := [name for name in table.head if name not in taken]:
        lines += ["", f"# not used: {', '.join(map(visible, left))}"]
    return "\n".join(lines) + "\n", not any(line.startswith("#") and " = " in line for line in lines)


def _time(table: CsvTable, numbers: Sequence[str]) -> list[str]:
    """The one column that ascends and is in a unit of time, or is called so."""
    rising = [name for name in numbers if np.all(np.diff(table.column(name)) > 0.0)]
    units = {name: known_unit(split_unit(name)[1]) for name in rising}
    timed = [name for name in rising if (found := units[name]) is not None and found.dimension == SECONDS]
    named = [name for name in rising if _words(name) & set(CLOCKS)]
    if len(timed) == 1:
        return [_line(TIME, timed[0])]
    offered = timed or named
    if not offered:
        return [f'# {TIME} = {{ column = "?", unit = "s" }}   # no column that ascends is called a time']
    unit = "" if timed else "s"
    return [f"# {_line(TIME, name, unit)}{'' if timed else '   # in which unit?'}" for name in offered]


def _angles(table: CsvTable, numbers: Sequence[str]) -> Iterator[list[str]]:
    """The encoders of both sides of the springs."""
    triples = [one for one in triples_of(table, numbers) if one.counts or _dimension(one.unit) == ANGLE]
    found = {side: [one for one in triples if one.words & set(words)] for side, words in SIDES.items()}
    # of two that are left the name of one tells the other
    for side, other in (("m", "l"), ("l", "m")):
        if not found[side] and len(found[other]) == 1 and len(triples) == 2:
            found[side] = [one for one in triples if one not in found[other]]
    for side in SIDES:
        sure = len(found[side]) == 1
        offered = found[side] or triples
        if not offered:
            name = f'"estimator.theta_{side}[0]"'
            yield [
                f'# {name} = {{ column = "?", unit = "deg" }}   # no three columns are angles or counts; 1 and 2, too'
            ]
        else:
            yield [
                f"{'' if sure else '# '}{_line(f'{signal}[{joint}]', column)}"
                for one in offered
                for signal in [f"encoder.count_{side}" if one.counts else f"estimator.theta_{side}"]
                for joint, column in enumerate(one.columns)
            ]


def _force(table: CsvTable, numbers: Sequence[str]) -> list[str]:
    """The measured force, pressing positive."""
    units = {name: split_unit(name)[1] for name in numbers}
    forces = [name for name in numbers if _dimension(units[name]) == FORCE]
    weights = [name for name in numbers if _dimension(units[name]) == MASS]
    if len(forces) + len(weights) == 1:
        (name,) = [*forces, *weights]
        # what a scale shows in grams is a weight
        unit = units[name] if forces else f"{units[name]}f"
        values = table.column(name)
        sign = -1 if abs(float(values.min())) > abs(float(values.max())) else 1
        return [_line(f"scale.{LAST}", name, unit, sign)]
    offered = [*forces, *weights] or [name for name in numbers if not units[name] and _words(name) & set(FORCES)]
    if not offered:
        return [f"# No column is a force: twin replay can still compare with --plant. scale.{LAST} has none."]
    return [
        f"# {_line(f'scale.{LAST}', name, '' if name in forces else f'{units[name]}f' if units[name] else 'N')}"
        f"{'' if units[name] else '   # in which unit?'}"
        for name in offered
    ]


def triples_of(table: CsvTable, numbers: Sequence[str]) -> list[Triple]:
    """Columns that differ in one number, which is that of the joint, in the order of the file."""
    stems: dict[tuple[str, str], dict[int, str]] = {}
    for column in numbers:
        name, unit = split_unit(column)
        if match := re.fullmatch(r"(.*?)(\d+)(\D*)", name):
            stems.setdefault((f"{match[1]}#{match[3]}", unit), {})[int(match[2])] = column
    found = []
    for (stem, unit), columns in stems.items():
        numbered: Mapping[int, str] = columns
        if sorted(numbered) in ([0, 1, 2], [1, 2, 3]):
            three = [numbered[joint] for joint in sorted(numbered)]
            whole = all(bool(np.all(table.column(name) == np.rint(table.column(name)))) for name in three)
            found.append(Triple((three[0], three[1], three[2]), _words(stem), unit, whole and unit in ("", "1")))
    return found


def _words(name: str) -> frozenset[str]:
    """The words of a name: `q_motor[1]` and `qMotor1` have q and motor."""
    apart = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", split_unit(name)[0])
    return frozenset(word.lower() for word in re.findall(r"[A-Za-z]+", apart))


def _dimension(unit: str) -> Dimension | None:
    found = known_unit(unit)
    return found.dimension if found and unit else None


def _line(signal: str, column: str, unit: str = "", sign: int = 1) -> str:
    """`"scale.F_z" = { column = "Fz_N", unit = "N" }`; unit: "": as the name of the column carries it."""
    name = signal if signal == TIME else json.dumps(signal)
    unit = unit or split_unit(column)[1]
    rest = (f", unit = {json.dumps(unit)}" if unit else "") + (", sign = -1" if sign < 0 else "")
    return f"{name} = {{ column = {_quoted(column)}{rest} }}"


def _quoted(name: str) -> str:
    return json.dumps(name, ensure_ascii=False)
