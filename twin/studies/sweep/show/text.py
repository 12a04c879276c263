"""What a sweep came to, in 80 columns: answer first, then reasons, then where files are."""

from collections.abc import Sequence

from twin.studies.lines import WIDTH, counted, wrapped
from twin.studies.sweep.folder import KeptRows
from twin.studies.sweep.show.parts import Asked, headline, parts
from twin.studies.sweep.show.table import Part


def sweep_text(kept: KeptRows, asked: Asked) -> str:
    """The report of a sweep."""
    lines = [headline_text(kept, asked.by)]
    for part in parts(kept, asked):
        lines += ["", *_part(part)]
    return "\n".join(line.rstrip() for line in lines)


def headline_text(kept: KeptRows, by: str) -> str:
    """The first sentence in lines of at most 80 characters."""
    return _folded(headline(kept, by))


def _part(part: Part) -> list[str]:
    lines = [_folded(part.title)]
    if part.rows:
        lines += _aligned([list(column) for column in zip(part.head, *part.rows, strict=True)])
    return lines + [_folded(remark, 4, "  ") for remark in part.remarks]


def _aligned(columns: Sequence[Sequence[str]]) -> list[str]:
    """Lines of a table; columns that do not fit in 80 are left out, and said to be."""
    lines = ["  "] * len(columns[0])
    left_out = 0
    for position, column in enumerate(columns):
        width = max(map(len, column))
        if len(lines[0]) + width > WIDTH:
            left_out = len(columns) - position
            break
        first = position == 0
        lines = [
            line + (f"{cell:<{width}}" if first else f"{cell:>{width}}") + "  "
            for line, cell in zip(lines, column, strict=True)
        ]
    return [*lines, f"  ({counted(left_out, 'more column')} in --html)"] if left_out else lines


def _folded(text: str, later: int = 2, first: str = "") -> str:
    return "\n".join(wrapped(text, first, later, whole=True))
