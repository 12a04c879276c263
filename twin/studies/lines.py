"""Text for people in lines of at most 80 columns."""

import textwrap
from collections.abc import Iterable, Sequence

WIDTH = 80


def wrapped(text: str, head: str = "", later: int | None = None, whole: bool = False) -> list[str]:
    """`text` after `head` in lines of `WIDTH`.

    Args:
        text: on one line.
        head: begins the first line.
        later: columns by which later lines are indented; None: they begin below the text.
        whole: names of files, signals and options stay whole: nothing is parted at hyphens, or because it is long.
    """
    indent = " " * (len(head) if later is None else later)
    return textwrap.wrap(
        text, WIDTH, initial_indent=head, subsequent_indent=indent, break_on_hyphens=not whole,
        break_long_words=not whole,
    )  # fmt: skip


def labelled(label: str, text: str, whole: bool = False) -> list[str]:
    """`text` beside its label, as all reports end with: `  note       ...`."""
    return wrapped(text, f"  {label:<10} ", whole=whole)


def markdown(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table of Markdown."""
    lines = [f"| {' | '.join(cells)} |" for cells in (head, *rows)]
    return "\n".join([lines[0], "|" + "---|" * len(head), *lines[1:]])


def first_few(texts: Sequence[str], most: int, more: str = "and {} more") -> list[str]:
    """At most so many of `texts`, and how many more there are."""
    left = len(texts) - most
    return [*texts[:most], *([more.format(left)] if left > 0 else [])]


def cut(text: str, length: int) -> str:
    """A value in at most so many characters."""
    return text if len(text) <= length else f"{text[: length - 3]}..."


def counted(count: int, noun: str) -> str:
    """`1 run`, `2 runs`."""
    return f"{count} {noun}{'' if count == 1 else 's'}"
