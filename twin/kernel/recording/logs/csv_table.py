"""CSV file as a table of numbers; other fields are kept by line, and errors have line numbers.

Fields are separated by commas, semicolons or tabs, whichever is most frequent in the head; numbers have a decimal
point. Lines that start with # are comments; those before the head are kept.
"""

import codecs
import csv
import io
import re
from array import array
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain, islice
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from twin.kernel.files import foreign_kind, open_regular
from twin.kernel.recording.logs.log import MAX_QUANTITY, LogError
from twin.kernel.units import has_plain_digits, parse_float

MAX_FILE_BYTES = 2**30
"""Maximum size (bytes): four hours of 36 columns at 200 Hz, and about as much memory."""
FIELD_SEPARATORS = ",;\t"
MAX_COLUMNS = 2_000
_BLOCK_BYTES = 2**20
BLOCK_ROWS = 200
"""Number of rows converted together, so that not all texts are in memory."""
INVALID_TEXT = re.compile(
    r"null|none|n/?a|<na>|nil|nat|missing|undefined|-+|\?+"
    r"|#\S+[!?a]"  # spreadsheets: #DIV/0!, #N/A
    r"|[-+]?(nan(\(\w*\))?|1\.#(qnan|snan|ind|inf)\d*)",  # C libraries: -nan(ind), 1.#QNAN
    re.IGNORECASE,
)
"""Spellings of a missing number, in addition to the spellings of NaN and infinity that float() reads."""
DECIMAL_COMMA = re.compile(r"[-+]?\d*,\d+([eE][-+]?\d+)?")
COMMENT_LINE = re.compile(r"#(\s|$)")
SEPARATOR_LINE = re.compile(r'"?sep=([^\s\w"]|\t)"?\s*', re.IGNORECASE)
"""First line of a file for Excel."""


@dataclass
class WrongFields:
    """Fields of one CSV column that are not finite numbers, some `empty`.

    `line` and `text` are of the first field with text other than `INVALID_TEXT`, else of the first field. `invalid` has
    the line of each field with NaN, infinity or `INVALID_TEXT`. `commas`: a field is a number with a decimal comma.
    """

    count: int = 0
    line: int = 0
    text: str = ""
    empty: int = 0
    invalid: "array[int]" = field(default_factory=lambda: array("q"))
    commas: bool = False

    @property
    def texts(self) -> int:
        """Number of wrong fields in the column that contain text, i.e. are neither empty nor an invalid number."""
        return self.count - self.empty - len(self.invalid)

    def add(self, line: int, text: str) -> None:
        empty, invalid = not text, INVALID_TEXT.fullmatch(text) is not None or parse_float(text) is not None
        if not self.count or not (empty or invalid or self.texts):
            self.line, self.text = line, text
        self.count += 1
        self.empty += empty
        if invalid:
            self.invalid.append(line)
        self.commas |= bool(DECIMAL_COMMA.fullmatch(text))


@dataclass(frozen=True)
class CsvTable:
    """Numbers (rows, columns) read from a CSV file, NaN for other fields; `wrong` has these by position of the column.

    `comments` are the lines before the head, without #; `lines` the line number of each row, from 1.
    """

    path: Path
    comments: tuple[str, ...]
    head: list[str]
    values: NDArray[np.float64]
    wrong: dict[int, WrongFields]
    lines: NDArray[np.int64]
    notes: tuple[str, ...] = ()

    def column(self, name: str) -> NDArray[np.float64]:
        if self.head.count(name) > 1:
            raise LogError(f"{self.path}: two columns are named '{name}'; expected different names")
        return self.values[:, self.head.index(name)]

    def wrong_fields(self, name: str) -> WrongFields | None:
        """Return the wrong fields of the CSV column `name`; None without wrong fields."""
        return self.wrong.get(self.head.index(name))

    def is_numbers(self, name: str) -> bool:
        """Check whether all non-empty fields of the CSV column `name` are numbers, and at least one exists."""
        wrong = self.wrong_fields(name)
        return wrong is None or (not wrong.texts and wrong.count < len(self.values))

    def is_words(self, name: str) -> bool:
        """Check whether the CSV column `name` has text and no numbers."""
        wrong = self.wrong_fields(name)
        return wrong is not None and wrong.count == len(self.values) and wrong.texts > 0 and not wrong.commas


def read_table(path: Path) -> CsvTable:
    with open_regular(path, MAX_FILE_BYTES) as file:
        return parse_table(path, file)


def parse_table(path: Path, file: BinaryIO) -> CsvTable:
    """Parse a CSV table from an open `file`; `path` is its name in error messages. Errors as of `read_table`."""
    end = _end_of_text(path, file)
    file.seek(end - 1)
    ended = file.read(1) in (b"\n", b"\r")
    zeros = file.read(1) != b""
    file.seek(0)
    text = io.TextIOWrapper(file, encoding="utf-8-sig", newline="")
    comments, head, separator, rows = _head(path, (line.rstrip("\0") for line in text) if zeros else text)
    values, lines, wrong = array("d"), array("q"), dict[int, WrongFields]()
    ragged, first, last = 0, (0, 0), (0, 0)
    while block := list(islice(rows, BLOCK_ROWS)):
        if not lines and len(block[0][0]) == len(head) + 1 and not block[0][0][-1].strip():
            # rows end with a separator, the head does not
            head.append("")
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
    # keeps the file open
    text.detach()
    notes: tuple[str, ...] = ("zeros at its end are left out",) if zeros else ()
    odd = wrong.get(len(head) - 1)
    broken = not ended and last[1] == len(head) and odd is not None and (odd.texts, odd.line) == (1, last[0])
    if broken or (ragged == 1 and not ended and last[1] < len(head)):
        # a killed logger leaves half a line
        ragged = 0 if not broken else ragged
        notes = (*notes, f"line {last[0]}, the last one, is cut short and left out")
    if broken:
        del values[-len(head) :], lines[-1:], wrong[len(head) - 1]
    if ragged:
        line, fields = first
        # 3,14 in a file separated by commas gives twice as many fields
        commas = fields > len(head) and separator == ","
        hint = "; are there decimal commas? Export with points" if commas else ""
        raise LogError(
            f"{path} line {line}: {fields} field{'s' * (fields > 1)}, expected {len(head)}"
            f"{more_text(ragged - 1, 'row')}{hint}"
        )
    if (many := len(lines)) < 2:
        raise LogError(f"{path}: {many} row{'s' * (many != 1)} of numbers, expected at least 2")
    array_of_rows = np.frombuffer(values).reshape(many, len(head))
    return CsvTable(path, comments, head, array_of_rows, wrong, np.frombuffer(lines, np.int64), notes)


def _end_of_text(path: Path, file: BinaryIO) -> int:
    """Check that `file` is text, and return its size without the zeros that a crash left at its end."""
    decoder, place, end, empty = codecs.getincrementaldecoder("utf-8")(), 0, 0, True
    while True:
        block = file.read(_BLOCK_BYTES)
        if place == 0 and (kind := foreign_kind(block)):
            raise LogError(f"{path}: {kind}; expected CSV in UTF-8")
        pending = len(decoder.getstate()[0])
        try:
            decoder.decode(block, final=not block)
        except UnicodeDecodeError as problem:
            where = place - pending + problem.start
            raise LogError(f"{path}: byte {where} is not UTF-8; save it as CSV in UTF-8") from None
        text = block.rstrip(b"\0")
        if b"\0" in text or (text and end < place):
            raise LogError(f"{path}: not a text file; expected CSV or MCAP")
        empty = empty and not text.removeprefix(codecs.BOM_UTF8).strip()
        end = place + len(text) if text else end
        place += len(block)
        if not block:
            break
    if empty:
        raise LogError(f"{path}: an empty file; expected a line of names, then rows of numbers")
    return end


def _head(path: Path, text: Iterator[str]) -> tuple[tuple[str, ...], list[str], str, Iterator[tuple[list[str], int]]]:
    """Parse the head of a CSV file from lines of text: (comments, names of the columns, separator, rows of `_rows`)."""
    comments: list[str] = []
    before, line = 0, ""
    for line in text:
        if line.strip() and not line.startswith("#"):
            break
        before += 1
        if line.strip():
            comments.append(line.removeprefix("#").strip())
    else:
        raise LogError(f"{path}: only comments; expected a line of names, then rows of numbers")
    separator = max(FIELD_SEPARATORS, key=line.count)
    if declared := SEPARATOR_LINE.fullmatch(line):
        separator, line, before = declared[1], next(text, ""), before + 1
    rows = _rows(path, chain([line], text), separator, before)
    names = [name.strip() for name in next(rows, ([""], 0))[0]]
    if len(names) > MAX_COLUMNS:
        raise LogError(f"{path}: {len(names):,} columns, expected at most {MAX_COLUMNS:,}")
    if all(_number(name) is not None for name in names):
        raise LogError(f"{path} line {before + 1}: numbers where the names of the columns are expected")
    if len(names) < 2:
        raise LogError(
            f"{path}: one column, '{names[0]}'; expected the time and at least one signal, with commas, semicolons or "
            "tabs between them; lines before the names begin with #"
        )
    return tuple(comments), names, separator, rows


def _rows(path: Path, lines: Iterator[str], separator: str, before: int) -> Iterator[tuple[list[str], int]]:
    """Yield (fields, line number) of each CSV row that is not blank, after `before` lines."""
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    try:
        for row in reader:
            # check the first field separately, since it is nearly always the time
            if row and (row[0].strip() or any(text.strip() for text in row)) and not COMMENT_LINE.match(row[0]):
                yield row, reader.line_num + before
    except csv.Error as problem:
        raise LogError(f"{path} line {reader.line_num + before}: not CSV: {problem}") from None


def more_text(others: int, what: str) -> str:
    """Format the end of an error message for further cases: ` (and 2 more such rows)`."""
    return f" (and {others} more such {what}{'s' * (others > 1)})" if others else ""


def _number(text: str) -> float | None:
    """Parse a text as a finite number; None for other text, and for values beyond any quantity."""
    value = parse_float(text)
    return value if value is not None and abs(value) <= MAX_QUANTITY else None


def _numbers(
    texts: Sequence[str], lines: Sequence[int], position: int, wrong: dict[int, WrongFields]
) -> NDArray[np.float64]:
    """Parse the texts of the CSV column at `position` as numbers; invalid ones become NaN, and are added to `wrong`."""
    try:
        values = np.fromiter(map(float, texts), np.float64, len(texts))
        # also false for NaN
        if np.all(np.abs(values) <= MAX_QUANTITY) and has_plain_digits("".join(texts)):
            return values
    except ValueError:
        pass
    found = [_number(text) for text in texts]
    for value, line, text in zip(found, lines, texts, strict=True):
        if value is None:
            wrong.setdefault(position, WrongFields()).add(line, text.strip())
    return np.array(found, dtype=np.float64)
