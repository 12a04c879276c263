"""The result of a study and its layout: text of 80 columns, JSON.

A study computes and returns a `Result`; where columns stand, how many digits they have and how sentences are folded is
said in its tables and notes, and done here.
"""

import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate, zip_longest
from math import isnan
from typing import Any

TEXT_WIDTH = 80
NO_BREAK_SPACE = "\xa0"
"""Between what is to stand on one line."""


def wrap_text(text: str, head: str = "", later: int | None = None, whole: bool = False) -> list[str]:
    """`text` after `head` in lines of `TEXT_WIDTH`.

    Args:
        text: on one line.
        head: begins the first line.
        later: columns by which later lines are indented; None: they begin below the text.
        whole: names of files, signals and options stay whole: nothing is parted at hyphens, or because it is long.
    """
    indent = " " * (len(head) if later is None else later)
    return textwrap.wrap(
        text, TEXT_WIDTH, initial_indent=head, subsequent_indent=indent, break_on_hyphens=not whole,
        break_long_words=not whole,
    )  # fmt: skip


def labelled_lines(label: str, text: str, whole: bool = False) -> list[str]:
    """`text` beside its label, as all reports end with: `  note       ...`."""
    return wrap_text(text, f"  {label:<10} ", whole=whole)


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of Markdown."""
    lines = [f"| {' | '.join(cells)} |" for cells in (head, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]])


def shorten(text: str, length: int) -> str:
    """A value in at most so many characters."""
    return text if len(text) <= length else f"{text[: length - 3]}..."


def join_names(names: Sequence[str], most: int) -> str:
    """`a, b and 3 more`: at most so many of `names`."""
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "")


def count_text(count: int, noun: str) -> str:
    """`1 run`, `2 runs`."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


Cell = str | float | None
"""Of a table: text as it stands, a number in the format of its column, NaN as `-`, None as nothing."""


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes:
        name: its title.
        width: its width, beyond which a cell moves what follows; 0: that of the widest cell.
        form: format of its numbers, such as ".3f", where a zero has no minus; or of its texts, such as ".14s".
        unit: below its title.
        left: whether it begins at the left, as names do.
        gap: spaces before it.
        folds: the last one: text that goes on in lines below.
    """

    name: str = ""
    width: int = 0
    form: str = ""
    unit: str = ""
    left: bool = False
    gap: int = 1
    folds: bool = False

    def text(self, value: Cell) -> str:
        """A cell as it is shown."""
        if value is None or isinstance(value, str):
            return format(value or "", self.form if self.form.endswith("s") else "")
        if isnan(value):
            return "-"
        text = format(value, self.form)
        return text if text.strip("-0.") else format(abs(0 * value), self.form)


@dataclass(frozen=True)
class Note:
    """A sentence that is folded into lines.

    Attributes:
        text: on one line; a no-break space is shown as a space.
        head: begins the first line.
        later: columns by which later lines are indented; None: they begin below the text.
        whole: names of files, signals and options stay whole.
    """

    text: str
    head: str = ""
    later: int | None = None
    whole: bool = False


Row = Sequence[Cell] | Note | str
"""Cells, at most as many as there are columns; or a line across all of them."""


@dataclass(frozen=True)
class Table:
    """Rows of cells.

    Attributes:
        columns: from the left.
        rows: from the top.
        indent: spaces before the first column.
        left_out: where columns are that do not fit in 80; "": all are shown.
        title: for JSON and HTML, where its place in the text is not seen.
    """

    columns: Sequence[Column]
    rows: Sequence[Row]
    indent: int = 2
    left_out: str = ""
    title: str = ""

    @property
    def cells(self) -> list[list[str]]:
        """Text of every row of cells, as many as there are columns."""
        return [
            [column.text(value) for column, value in zip_longest(self.columns, row)]
            for row in self.rows
            if not isinstance(row, Note | str)
        ]


Block = Table | Note | str
"""Of a text; a string is a line as it stands, so "" is an empty one."""


def note(label: str, text: str, whole: bool = False) -> Note:
    """A sentence beside its label: `  note       ...`."""
    return Note(text, f"  {label:<10} ", whole=whole)


@dataclass(frozen=True)
class Result:
    """What a study found.

    Attributes:
        headline: the answer.
        body: what there is to say besides, in this order.
        facts: for programs, in SI units; None: headline, tables and notes as they are, see `to_json`.
        files: what was written, by what it is.
        label: columns of their labels; 0: they have none.
        exit_code: of a command that asks this; 0 or, of what was judged, 1 and more if it failed.
    """

    headline: Block
    body: Sequence[Block] = ()
    facts: Any = None
    files: Mapping[str, object] = field(default_factory=dict)
    label: int = 10
    exit_code: int = 0

    @property
    def text(self) -> str:
        """See `render_text`."""
        return render_text(self)


def render_text(result: Result) -> str:
    """`result` for people, in lines of at most 80 columns but for what cannot be folded."""
    files = [f"  {kind:<{result.label}} {file}" if result.label else f"  {file}" for kind, file in result.files.items()]
    return lay_out([result.headline, *result.body, *files])


def lay_out(blocks: Sequence[Block]) -> str:
    """The text of `blocks`, one below the other."""
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
    shown = sum(end <= TEXT_WIDTH for end in ends) if table.left_out else len(columns)

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
    """`result` for programs: its facts, or, where it has none, what people read, with numbers as they are."""
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
    """The sentence of a part, its label before it; a table and an empty line have none."""
    match part:
        case Note():
            return [f"{label}: {part.text}" if (label := part.head.strip()) else part.text]
        case str() if part.strip():
            return [part.strip()]
    return []
