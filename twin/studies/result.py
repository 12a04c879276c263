"""The result of a study, tables and notes, and its layout: text of the terminal's width, JSON."""

import os
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate, zip_longest
from math import isnan
from typing import Any

TEXT_WIDTH = 80
"""Width of a text (columns) in a file, a pipe or a notebook."""
MIN_TERMINAL_WIDTH, MAX_TERMINAL_WIDTH = 40, 120
"""Minimum and maximum width of a text (columns) on a terminal; longer lines are hard to read."""
WIDTH_VARIABLE = "TWIN_TEXT_WIDTH"
"""Environment variable with the width of the terminal; worker processes, which have no terminal, inherit it."""
NO_BREAK_SPACE = "\xa0"


def text_width() -> int:
    """Return the maximum width of a text (columns): the width of the terminal, else `TEXT_WIDTH`."""
    width = os.environ.get(WIDTH_VARIABLE, "")
    return min(max(int(width), MIN_TERMINAL_WIDTH), MAX_TERMINAL_WIDTH) if width.isdecimal() else TEXT_WIDTH


def wrap_text(text: str, head: str = "", later: int | None = None, whole: bool = False) -> list[str]:
    """Wrap `text` after `head` into lines of at most `text_width` columns.

    Args:
        head: beginning of the first line.
        later: indent of later lines (columns); None to align with the text of the first line.
        whole: whether names of files, signals and options stay whole: no break at hyphens or inside long words.
    """
    indent = " " * (len(head) if later is None else later)
    return textwrap.wrap(
        text, text_width(), initial_indent=head, subsequent_indent=indent, break_on_hyphens=not whole,
        break_long_words=not whole,
    )  # fmt: skip


def labelled_lines(label: str, text: str, whole: bool = False) -> list[str]:
    """Wrap a text behind its label, in the layout of notes at the end of reports: `  note       ...`."""
    return wrap_text(text, f"  {label:<10} ", whole=whole)


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [f"| {' | '.join(cells)} |" for cells in (head, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]])


def shorten(text: str, length: int) -> str:
    """Truncate `text` to at most `length` characters, with `...` at the end if it is cut."""
    return text if len(text) <= length else f"{text[: length - 3]}..."


def join_names(names: Sequence[str], most: int) -> str:
    """Join names with commas; beyond `most` names, count the rest: `a, b, c` or `a, b and 3 more`."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def count_text(count: int, noun: str) -> str:
    return f"{count} {noun}{'' if count == 1 else 's'}"


Cell = str | float | None
"""Cell of a table: a text is shown unchanged, a number in the format of its column, NaN as `-`, None as empty."""


@dataclass(frozen=True)
class Column:
    """A column of a result's table: title, width, number format.

    Attributes:
        width: minimum width; a wider cell shifts the rest of its row. 0 for the width of the widest cell.
        form: format of numbers, such as ".3f" (zero is shown without a minus sign), or of texts, such as ".14s".
        unit: unit, shown below the title.
        left: whether cells are left-aligned, as names are.
        gap: spaces before the column.
        folds: whether long text wraps into the lines below; only for the last column.
    """

    name: str = ""
    width: int = 0
    form: str = ""
    unit: str = ""
    left: bool = False
    gap: int = 1
    folds: bool = False

    def text(self, value: Cell) -> str:
        if value is None or isinstance(value, str):
            return format(value or "", self.form if self.form.endswith("s") else "")
        if isnan(value):
            return "-"
        text = format(value, self.form)
        return text if text.strip("-0.") else format(abs(0 * value), self.form)


@dataclass(frozen=True)
class Note:
    """A sentence of a report that is wrapped into lines; the fields are the arguments of `wrap_text`."""

    text: str
    head: str = ""
    later: int | None = None
    whole: bool = False


Row = Sequence[Cell] | Note | str
"""Row of a table: cells, at most one per column, or a line across all columns."""


@dataclass(frozen=True)
class Table:
    """A table of a report, for text, JSON and HTML.

    Attributes:
        indent: spaces before the first column.
        left_out: place where the columns beyond the width of the text can be found; "" to show all columns.
        title: title in JSON and HTML, where the surrounding text is missing.
    """

    columns: Sequence[Column]
    rows: Sequence[Row]
    indent: int = 2
    left_out: str = ""
    title: str = ""

    @property
    def cells(self) -> list[list[str]]:
        """Formatted cells of every table row except lines across, one text per column."""
        return [
            [column.text(value) for column, value in zip_longest(self.columns, row)]
            for row in self.rows
            if not isinstance(row, Note | str)
        ]


Block = Table | Note | str
"""Part of a text; a string is a complete line, so "" is an empty line."""


def note(label: str, text: str, whole: bool = False) -> Note:
    """Return a sentence of a report behind its label: `  note       ...`."""
    return Note(text, f"  {label:<10} ", whole=whole)


@dataclass(frozen=True)
class Result:
    """The result of a study: headline, tables, notes, data for programs, files.

    Attributes:
        body: remaining parts of the text, in order.
        facts: values for programs, in SI units; None to derive JSON from headline, tables and notes, see `to_json`.
        files: kind -> file written.
        label: width of the labels of files (columns); 0 for no labels.
        exit_code: exit code of the command: 0, or 1 and more if a judged result failed.
    """

    headline: Block
    body: Sequence[Block] = ()
    facts: Any = None
    files: Mapping[str, object] = field(default_factory=dict)
    label: int = 10
    exit_code: int = 0

    @property
    def text(self) -> str:
        return render_text(self)


def render_text(result: Result) -> str:
    """Render `result` as text, at most `text_width` columns wide except where a line cannot be folded."""
    files = [f"  {kind:<{result.label}} {file}" if result.label else f"  {file}" for kind, file in result.files.items()]
    return lay_out([result.headline, *result.body, *files])


def lay_out(blocks: Sequence[Block]) -> str:
    return "\n".join(line.rstrip() for block in blocks for line in _lines(block))


def _lines(part: Block) -> Sequence[str]:
    match part:
        case Table():
            return list(_table(part))
        case Note():
            lines = wrap_text(part.text, part.head, part.later, part.whole) or [part.head]
            return [line.replace(NO_BREAK_SPACE, " ") for line in lines]
    return [part]


def _table(table: Table) -> Iterator[str]:
    columns, cells = table.columns, table.cells
    titles = [[column.name for column in columns], [column.unit for column in columns]]
    head = [row for row in titles if any(row)]
    widths = [c.width or max(len(row[i]) for row in (*titles, *cells)) for i, c in enumerate(columns)]
    gaps = [table.indent, *(column.gap for column in columns[1:])]
    ends = accumulate(map(sum, zip(gaps, widths, strict=True)))
    shown = sum(end <= text_width() for end in ends) if table.left_out else len(columns)

    def line(row: Sequence[str]) -> Iterator[str]:
        text = ""
        for column, cell, gap, width in zip(columns[:shown], row, gaps, widths, strict=False):
            text += " " * gap
            if column.folds:
                yield from wrap_text(cell, text) or [text]
                return
            text += f"{cell:{'<' if column.left else '>'}{width}}"
        yield text

    rest = iter(cells)
    for titles_of in head:
        yield from line(titles_of)
    for row in table.rows:
        yield from _lines(row) if isinstance(row, Note | str) else line(next(rest))
    if shown < len(columns):
        yield f"  ({count_text(len(columns) - shown, 'more column')} in {table.left_out})"


def to_json(result: Result) -> Any:
    """Convert a study's result for JSON: its facts, else headline, tables and notes with unformatted numbers."""
    if result.facts is not None:
        return result.facts
    parts = [result.headline, *result.body]
    return {
        "headline": " ".join(_plain(result.headline)),
        "tables": [
            {
                "title": part.title,
                "columns": [{"name": column.name, "unit": column.unit} for column in part.columns],
                "rows": [list(row) for row in part.rows if not isinstance(row, Note | str)],
            }
            for part in parts
            if isinstance(part, Table)
        ],
        "notes": [text for part in result.body for text in _plain(part)],
        "files": {kind: str(file) for kind, file in result.files.items()},
    }


def _plain(part: Block) -> list[str]:
    """Return a note's or line's text as a list, with its label in front; empty for a table or an empty line."""
    match part:
        case Note():
            return [f"{label}: {part.text}" if (label := part.head.strip()) else part.text]
        case str() if part.strip():
            return [part.strip()]
    return []
