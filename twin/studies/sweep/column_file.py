"""The columns of rows.jsonl beside it, so that a million rows are parsed once; a copy that may be deleted."""

import contextlib
import json
import sys
import zlib
from pathlib import Path

import numpy as np
from pydantic import Field

from twin.errors import InputRefused
from twin.files import read_bytes
from twin.studies.sweep.columns import Column, Columns, Words
from twin.studies.sweep.rows import LARGEST, MOST_RUNS, Shape, Whole, parsed, read_columns
from twin.writing import written

SUFFIX = ".columns"
MANY = 10_000
"""Rows from which on there is a copy: to parse fewer takes no time to speak of."""
LAYOUT = f"1 {sys.byteorder}"
"""Of the file; raised with every change of it or of `Columns`."""
_NONE = type(None)
TYPES: dict[str, set[type]] = {
    "drive": {str, _NONE}, "status": {str}, "reason": {str}, "within_limits": {bool, _NONE},
    "has_metrics": {bool}, "has_curves": {bool}, "verdicts": {str, _NONE}, "parameters": {bool, int, float, str, _NONE},
}  # fmt: skip
"""Words that a column may have, by its name or group."""
NUMBERS = {"run", "seconds", "stepping_s", "metrics", "values", "parameters"}
NEEDED = {"run", "seconds", "stepping_s", "drive", "status", "reason", "within_limits", "has_metrics", "has_curves"}


class Head(Shape):
    """The first line: what the file is of, and which columns follow; of each its words, None: numbers."""

    layout: str
    size: int
    mtime_ns: int
    crc: int
    rows: int = Field(ge=0, le=MOST_RUNS)
    columns: dict[str, list[bool | Whole | float | str | None] | None]


def columns_in(path: Path, keys: bool = False) -> Columns:
    """The rows of the file at `path` by run: from the copy beside it if that fits, else parsed.

    Of many rows that had to be parsed a copy is left, where the folder may be written to.

    Args:
        keys: with the column "key", which no copy has.

    Raises:
        InputRefused: as `read_columns`.
    """
    beside, stamp = path.with_suffix(SUFFIX), _stamp(path)
    copy = _read(beside, stamp)
    if copy is not None and not keys:
        return copy
    found = read_columns(path)[0].by_run()
    # rows that came meanwhile are not all in it
    if copy is None and len(found) >= MANY and stamp == _stamp(path):
        with contextlib.suppress(InputRefused):
            _write(found, beside, stamp)
    return found


def _stamp(path: Path) -> tuple[int, int]:
    """(bytes, time of the last change in ns) of the file at `path`; zeros of none."""
    try:
        found = path.stat()
    except OSError:
        return 0, 0
    return found.st_size, found.st_mtime_ns


def _write(columns: Columns, path: Path, stamp: tuple[int, int]) -> None:
    # numbers first, so that each begins at a multiple of eight bytes
    ordered = sorted(columns.of.items(), key=lambda item: isinstance(item[1], Words))
    ordered = [(name, one) for name, one in ordered if name != "key"]
    body = [(one.codes if isinstance(one, Words) else one).tobytes() for _, one in ordered]
    crc = 0
    for part in body:
        crc = zlib.crc32(part, crc)
    words = {name: one.words if isinstance(one, Words) else None for name, one in ordered}
    size, mtime = stamp
    facts = {"layout": LAYOUT, "size": size, "mtime_ns": mtime, "crc": crc, "rows": len(columns), "columns": words}
    head = json.dumps(facts).encode()
    head += b" " * (-(len(head) + 1) % 8) + b"\n"
    with written(path) as beside, beside.open("wb") as file:
        file.writelines([head, *body])


def _read(path: Path, stamp: tuple[int, int]) -> Columns | None:
    """What `_write` wrote of the file that is still as it was then; None: there is no such thing."""
    if not path.is_file():
        return None
    try:
        content = read_bytes(path, LARGEST)
    except InputRefused:
        return None
    start = content.find(b"\n") + 1
    head = parsed(content[:start], Head)
    if head is None or (head["layout"], head["size"], head["mtime_ns"]) != (LAYOUT, *stamp):
        return None
    rows, words = head["rows"], head["columns"]
    sizes = [rows * (4 if known else 8) for known in words.values()]
    body = memoryview(content)[start:]
    if start % 8 or len(body) != sum(sizes) or zlib.crc32(body) != head["crc"] or not NEEDED <= words.keys():
        return None
    found: dict[str, Column] = {}
    for (name, known), size, end in zip(words.items(), sizes, np.cumsum(sizes).tolist(), strict=True):
        column = body[end - size : end]
        found[name] = np.frombuffer(column, float) if known is None else Words(np.frombuffer(column, np.int32), known)
    return Columns(found) if all(_is_sound(name, one) for name, one in found.items()) else None


def _is_sound(name: str, column: Column) -> bool:
    """Whether a column is what rows can make of it; whoever goes on with it looks no more."""
    group = name.partition("/")[0]
    if isinstance(column, Words):
        codes = column.codes
        inside = len(codes) == 0 or (codes.min() >= 0 and codes.max() < len(column.words))
        return bool(inside) and {*map(type, column.words)} <= TYPES.get(group, set())
    if name == "run":
        return bool(np.all((column >= 1) & (column <= MOST_RUNS)) and np.all(column[1:] >= column[:-1]))
    return group in NUMBERS and not np.isinf(column).any()
