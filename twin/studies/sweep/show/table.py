"""A part of what is said about a sweep."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Part:
    """A table with a title and sentences.

    Attributes:
        key: short name.
        head: titles of the columns, rows: cells, as many in each; empty if there is no table.
        remarks: sentences to it.
        notes: by first cell, what it means; for a page, which has the room.
        text_only: titles of columns that a page does without, because it has a picture.
    """

    key: str
    title: str
    head: Sequence[str]
    rows: Sequence[Sequence[str]]
    remarks: Sequence[str] = ()
    notes: Mapping[str, str] = field(default_factory=dict)
    text_only: Sequence[str] = ()
