"""The head of a CSV file, and its rows as texts.

Fields are separated by commas, semicolons or tabs, whichever the head holds most of; numbers have a decimal point.
Lines before the head that start with # are comments and are kept.
"""

import codecs
import csv
import io
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import BinaryIO, NamedTuple

from twin.files import foreign_kind
from twin.recording.logs.errors import LogRefused

SEPARATORS = ",;\t"
MOST_COLUMNS = 2_000
LARGEST = 1e100
"""No quantity of a robot is larger, and its square is still a number."""
_BLOCK = 2**20


class CsvHead(NamedTuple):
    """comments and names as in `Table`; separator; how many lines the comments take up, and with the head."""

    comments: tuple[str, ...]
    names: list[str]
    separator: str
    before: int
    until: int


def number(text: str) -> float | None:
    """The finite number that `text` spells; None if it spells none, or one that no quantity has."""
    try:
        value = float(text)
    except ValueError:
        return None
    return value if abs(value) <= LARGEST else None


def text_of(file: BinaryIO) -> io.TextIOWrapper:
    """`file` from its beginning as text; to be detached, so that it stays open."""
    file.seek(0)
    return io.TextIOWrapper(file, encoding="utf-8-sig", newline="")


def refuse_foreign(path: Path, file: BinaryIO) -> None:
    """Read `file` once to see that it is text.

    Raises:
        LogRefused: it is something else, or empty.
    """
    decoder, place, empty = codecs.getincrementaldecoder("utf-8")(), 0, True
    while True:
        block = file.read(_BLOCK)
        if place == 0 and (kind := foreign_kind(block)):
            raise LogRefused(f"{path}: {kind}; expected CSV in UTF-8")
        held = len(decoder.getstate()[0])
        try:
            decoder.decode(block, final=not block)
        except UnicodeDecodeError as problem:
            where = place - held + problem.start
            raise LogRefused(f"{path}: byte {where} is not UTF-8; save it as CSV in UTF-8") from None
        if b"\0" in block:
            raise LogRefused(f"{path}: not a text file; expected CSV or MCAP")
        empty = empty and not block.removeprefix(codecs.BOM_UTF8).strip()
        place += len(block)
        if not block:
            break
    if empty:
        raise LogRefused(f"{path}: an empty file; expected a line of names, then rows of numbers")


def head_of(path: Path, text: io.TextIOWrapper) -> CsvHead:
    """The head of the file at `path`, whose `text` is detached then.

    Raises:
        LogRefused: there is none, or one that names no table.
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
    names, until = next(rows_of(path, chain([line], text), separator, before))
    text.detach()
    if len(names) > MOST_COLUMNS:
        raise LogRefused(f"{path}: {len(names):,} columns, expected at most {MOST_COLUMNS:,}")
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise LogRefused(f"{path}: two columns are named '{twice}'; expected different names")
    if all(number(name) is not None for name in names):
        raise LogRefused(f"{path} line {before + 1}: numbers where the names of the columns are expected")
    if len(names) < 2:
        raise LogRefused(f"{path}: one column, '{names[0]}'; expected the time and at least one signal")
    return CsvHead(tuple(comments), names, separator, before, until)


def rows_of(path: Path, lines: Iterator[str], separator: str, before: int) -> Iterator[tuple[list[str], int]]:
    """(fields, number of the line) of each row that is not empty; `before` lines have been read."""
    reader = csv.reader(lines, delimiter=separator, skipinitialspace=True)
    try:
        for row in reader:
            if row:
                yield [text.strip() for text in row], reader.line_num + before
    except csv.Error as problem:
        raise LogRefused(f"{path} line {reader.line_num + before}: not CSV: {problem}") from None
