"""The columns of rows.jsonl beside it, so that a million rows are parsed once; a copy that may be deleted."""

import contextlib
import json
import sys
import zlib
from pathlib import Path

import numpy as np
from pydantic import Field

from twin.errors import InputRefused, NotWritten
from twin.files import read_bytes
from twin.studies.sweep.columns import Column, Columns, Words
from twin.studies.sweep.rows import LARGEST, MOST_RUNS, Shape, Whole, parsed, read_columns
from twin.writing import written

SUFFIX = ".columns"
MANY = 10_000
"""Rows from which on there is a copy: to parse fewer takes no time to speak of."""
LAYOUT = f"1 {sys.byteorder}"
"""Of the file: a head, the columns, a sum of both; raised with every change of it or of `Columns`."""
_NONE = type(None)
TYPES: dict[str, set[type]] = {
    "drive": {str, _NONE}, "status": {str}, "reason": {str}, "within_limits": {bool, _NONE},
    "has_metrics": {bool}, "has_curves": {bool}, "verdicts": {str, _NONE}, "parameters": {bool, int, float, str, _NONE},
}  # fmt: skip
"""Words that a column may have, by its name or group."""
NUMBERS = {"run", "seconds", "stepping_s", "metrics", "values", "parameters"}
NEEDED = {"run", "seconds", "stepping_s", "drive", "status", "reason", "within_limits", "has_metrics", "has_curves"}
SUM = 4
"""Bytes of the sum (CRC-32), which end the file."""


class Head(Shape):
    """The first line: what the file is of, and which columns follow; of each its words, None: numbers."""

    layout: str
    size: int
    mtime_ns: int
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
        with contextlib.suppress(InputRefused, NotWritten):
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
    words = {name: one.words if isinstance(one, Words) else None for name, one in ordered}
    size, mtime = stamp
    facts = {"layout": LAYOUT, "size": size, "mtime_ns": mtime, "rows": len(columns), "columns": words}
    head = json.dumps(facts).encode()
    head += b" " * (-(len(head) + 1) % 8) + b"\n"
    crc = 0
    with written(path) as beside, beside.open("wb") as file:
        for part in (head, *((one.codes if isinstance(one, Words) else one).tobytes() for _, one in ordered)):
            crc = zlib.crc32(part, crc)
            file.write(part)
        file.write(crc.to_bytes(SUM))


def _read(path: Path, stamp: tuple[int, int]) -> Columns | None:
    """What `_write` wrote of the file that is still as it was then; None: there is no such thing."""
    if not path.is_file():
        return None
    try:
        content = read_bytes(path, LARGEST)
    except InputRefused:
        return None
    whole, check = memoryview(content)[:-SUM], content[-SUM:]
    start = content.find(b"\n") + 1
    head = parsed(content[:start], Head)
    if head is None or (head["layout"], head["size"], head["mtime_ns"]) != (LAYOUT, *stamp):
        return None
    rows, words = head["rows"], head["columns"]
    sizes = [rows * (8 if known is None else 4) for known in words.values()]
    body = whole[start:]
    if start % 8 or len(body) != sum(sizes) or not NEEDED <= words.keys() or zlib.crc32(whole) != int.from_bytes(check):
        return None
    found: dict[str, Column] = {}
    for (name, known), size, end in zip(words.items(), sizes, np.cumsum(sizes).tolist(), strict=True):
        column = body[end - size : end]
        found[name] = np.frombuffer(column, float) if known is None else Words(np.frombuffer(column, np.int32), known)
    judged = {name.replace("verdicts", "values", 1) for name in found if name.startswith("verdicts/")}
    is_sound = judged <= found.keys() and all(_is_sound(name, one) for name, one in found.items())
    return Columns(found) if is_sound else None


def _is_sound(name: str, column: Column) -> bool:
    """Whether a column is what rows can make of it; whoever goes on with it looks no more."""
    group = name.partition("/")[0]
    if isinstance(column, Words):
        codes = column.codes
        inside = len(codes) == 0 or (codes.min() >= 0 and codes.max() < len(column.words))
        return bool(inside) and group in TYPES and {*map(type, column.words)} <= TYPES[group]
    if name == "run":
        return bool(np.all((column >= 1) & (column <= MOST_RUNS)) and np.all(column[1:] >= column[:-1]))
    return group in NUMBERS and not np.isinf(column).any()
