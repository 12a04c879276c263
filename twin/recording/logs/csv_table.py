"""The text of a CSV file as a table of numbers.

A file that is as it should be is read by numpy in one go; any other row by row, which is slower and knows where each
mistake is.
"""

import io
import math
import warnings
from array import array
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from twin.errors import InputRefused
from twin.files import open_regular
from twin.recording.logs.csv_head import LARGEST, CsvHead, head_of, number, refuse_foreign, rows_of, text_of
from twin.recording.logs.errors import LogRefused

LARGEST_FILE = 2**30
"""Bytes; four hours of 36 columns at 200 Hz, and about as much memory."""
_BLOCK = 2**20


@dataclass
class Wrong:
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
    wrong: dict[int, Wrong]
    lines: NDArray[np.int64]

    def column(self, name: str) -> NDArray[np.float64]:
        """The numbers of the column `name`."""
        return self.values[:, self.head.index(name)]

    def mistakes(self, name: str) -> Wrong | None:
        """What of the column `name` is no number; None: nothing."""
        return self.wrong.get(self.head.index(name))

    def is_words(self, name: str) -> bool:
        """Whether no field of the column `name` is a number, so that it says something else."""
        wrong = self.mistakes(name)
        return wrong is not None and wrong.count == len(self.values) and wrong.texts and not wrong.commas


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
    refuse_foreign(path, file)
    head = head_of(path, text_of(file))
    return _at_once(path, file, head) or _row_by_row(path, file, head)


def more(others: int, what: str) -> str:
    """` (and 2 more such rows)`."""
    return f" (and {others} more such {what}{'s' * (others > 1)})" if others else ""


def _at_once(path: Path, file: BinaryIO, head: CsvHead) -> CsvTable | None:
    """The table, if each line after the head has as many fields, and only columns that begin with something else hold
    anything but numbers; None if not."""
    text = text_of(file)
    for _ in range(head.until):
        next(text)
    first, _ = next(rows_of(path, text, head.separator, head.until), ([], 0))
    text.detach()
    wrong: dict[int, Wrong] = {}

    def noted(position: int) -> Callable[[str], float]:
        lines = count(head.until + 1)

        def value(field: str) -> float:
            line, found = next(lines), number(field.strip())
            if found is None:
                wrong.setdefault(position, Wrong()).add(line, field.strip())
            return math.nan if found is None else found

        return value

    words = [position for position, field in enumerate(first) if number(field) is None]
    text = text_of(file)
    try:
        with warnings.catch_warnings():
            # that there are no rows is told in a sentence
            warnings.simplefilter("ignore")
            values = np.loadtxt(
                text, delimiter=head.separator, comments=None, quotechar='"', skiprows=head.until, ndmin=2,
                converters={position: noted(position) for position in words},
            )  # fmt: skip
    except ValueError:
        return None
    finally:
        text.detach()
    if len(values) < 2 or values.shape[1] != len(head.names) or _lines(file) != head.until + len(values):
        return None
    for position in set(range(len(head.names))) - set(words):
        column = values[:, position]
        # nan is no number either
        if not (-LARGEST <= column.min() and column.max() <= LARGEST):
            return None
    return CsvTable(path, head.comments, head.names, values, wrong, head.until + 1 + np.arange(len(values)))


def _lines(file: BinaryIO) -> int:
    """How many lines a file has that is not empty."""
    file.seek(0)
    ends = sum(block.count(b"\n") for block in iter(lambda: file.read(_BLOCK), b""))
    file.seek(-1, io.SEEK_END)
    return ends + (file.read() != b"\n")


def _row_by_row(path: Path, file: BinaryIO, head: CsvHead) -> CsvTable:
    # lists of numbers would take five times the memory
    numbers, lines, wrong = array("d"), array("q"), dict[int, Wrong]()
    ragged, first = 0, (0, 0)
    text = text_of(file)
    for _ in range(head.until):
        next(text)
    for row, line in rows_of(path, text, head.separator, head.until):
        if not any(row):
            continue
        if len(row) != len(head.names):
            first = first if ragged else (line, len(row))
            ragged += 1
            continue
        lines.append(line)
        for position, field in enumerate(row):
            value = number(field)
            if value is None:
                wrong.setdefault(position, Wrong()).add(line, field)
            numbers.append(math.nan if value is None else value)
    text.detach()
    if ragged:
        line, fields = first
        # 3,14 in a file separated by commas gives twice as many fields
        commas = fields > len(head.names) and head.separator == ","
        hint = "; are there decimal commas? Export with points" if commas else ""
        raise LogRefused(
            f"{path} line {line}: {fields} field{'s' * (fields > 1)}, expected {len(head.names)}"
            f"{more(ragged - 1, 'row')}{hint}"
        )
    if (many := len(lines)) < 2:
        raise LogRefused(f"{path}: {many} row{'s' * (many != 1)} of numbers, expected at least 2")
    values = np.frombuffer(numbers).reshape(many, len(head.names))
    return CsvTable(path, head.comments, head.names, values, wrong, np.frombuffer(lines, dtype=np.int64))
