"""The rows of a sweep on disk: a JSON Lines file, append-only."""

import json
import os
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import Annotated, Any, NotRequired

import numpy as np
from pydantic import ConfigDict, Field, TypeAdapter, ValidationError, with_config

# pydantic accepts only the typing_extensions version before Python 3.12.
from typing_extensions import TypedDict

from twin.kernel.errors import ComponentFailed, InputRefused, translate_disk_errors
from twin.kernel.files import open_regular
from twin.studies.sweep.columns import Columns, Row, columns_of, concatenate_columns

ROWS_FILE = "rows.jsonl"
MAX_FILE_SIZE = 2**32
"""Maximum size (bytes); 100,000 rows with curves take a quarter of it."""
MAX_RUNS = 20_000_000
"""Maximum number of runs of a sweep; statistics allocate an entry for each."""
ROWS_PER_BATCH = 1_000
"""Rows converted to columns at a time; rows take ten times the memory of columns."""
WholeNumber = Annotated[int, Field(ge=-(2**63), lt=2**64)]
LOOSE_SHAPE = ConfigDict(extra="ignore", strict=True, allow_inf_nan=False)
"""Validation of files that another version, possibly with more keys, or another program wrote."""


@with_config(LOOSE_SHAPE)
class ClaimShape(TypedDict):
    """JSON structure of a claim's result in a sweep's row: verdict and measured value."""

    verdict: str
    value: float | None


@with_config(LOOSE_SHAPE)
class CurvesShape(TypedDict):
    """JSON structure of the curves in a sweep's row; an empty table if the run has none."""

    period_s: NotRequired[Annotated[float, Field(gt=0, le=1e6)]]
    of: NotRequired[dict[str, str]]


@with_config(LOOSE_SHAPE)
class RowShape(TypedDict):
    """JSON structure of a line of rows.jsonl, one per run of a sweep."""

    run: Annotated[int, Field(ge=1, le=MAX_RUNS)]
    key: str
    drive: str | None
    parameters: dict[str, bool | WholeNumber | float | str]
    status: str
    reason: str
    metrics: dict[str, float | None]
    within_limits: bool | None
    seconds: float | None
    stepping_s: float | None
    no_hold: NotRequired[str]
    claims: NotRequired[dict[str, ClaimShape]]
    curves: NotRequired[CurvesShape | None]


_ROW_ADAPTER: TypeAdapter[Any] = TypeAdapter(RowShape)


def load_json(text: str | bytes, shape: TypeAdapter[Any]) -> dict[str, Any] | None:
    try:
        found = json.loads(text)
        shape.validate_python(found)
    # pydantic's ValidationError is a ValueError too.
    except (ValueError, RecursionError):
        return None
    return found


def _row(line: bytes) -> Row | None:
    """Parse a line of rows; None if invalid. The slower standard library reads texts that the fast parser rejects."""
    try:
        found: Row = _ROW_ADAPTER.validate_json(line)
    except ValidationError:
        return load_json(line, _ROW_ADAPTER)
    return found


class DiskError(ComponentFailed):
    """Error for a row of a sweep that cannot be written to the disk; earlier rows are kept."""


def read_rows(path: Path) -> list[Row]:
    """Load the complete rows of a sweep's file with all fields, oldest first; of duplicate keys the first wins."""
    rows: dict[str, Row] = {}
    for row, line, _ in _whole_lines(path):
        rows.setdefault(row["key"], json.loads(line))
    return list(rows.values())


def read_columns(path: Path) -> tuple[Columns, int]:
    """Load the complete rows of a sweep's file as columns; return them and their size in the file (bytes).

    Rows are ordered oldest first; of duplicate keys the first wins. An incomplete last line, left by a power cut, is
    ignored. InputRefused: the file cannot be read, or a line is no row of a sweep.
    """
    parts, end, each = [], 0, _whole_lines(path)
    while some := list(islice(each, ROWS_PER_BATCH)):
        parts.append(columns_of([row for row, _, _ in some]))
        end = some[-1][-1]
    found = concatenate_columns(parts or [columns_of([])])
    _, first = np.unique(found.categorical("key").codes, return_index=True)
    return (found if len(first) == len(found) else found.select(np.sort(first))), end


def _whole_lines(path: Path) -> Iterator[tuple[Row, bytes, int]]:
    """Yield (row, line, file offset of the line's end) of each complete line, nothing without a file."""
    if not os.path.lexists(path):
        return
    end = 0
    with open_regular(path, MAX_FILE_SIZE) as file, translate_disk_errors(path, "cannot be read", InputRefused):
        for number, line in enumerate(file, start=1):
            if not line.endswith(b"\n"):
                return
            row = _row(line)
            if row is None:
                raise InputRefused(f"{path}: line {number} is not a row of a sweep; remove the line to repeat its run")
            end += len(line)
            yield row, line, end


class RowFile:
    """The rows' file, opened for appending and locked, a context manager; `before`: rows found, oldest first."""

    def __init__(self, path: Path):
        # Windows has neither fcntl nor guarded processes.
        import fcntl

        self.path = path
        with translate_disk_errors(path, kind=InputRefused, remedy="choose another --out"):
            self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.before, self._end = read_columns(path)
        except BlockingIOError:
            os.close(self._fd)
            raise InputRefused(f"{path}: another twin sweep is writing there; wait for it, or choose --out") from None
        except InputRefused:
            os.close(self._fd)
            raise
        os.ftruncate(self._fd, self._end)
        self.count = len(self.before)

    def __enter__(self) -> "RowFile":
        return self

    def __exit__(self, *failure: object) -> None:
        os.close(self._fd)

    def add(self, batch: list[Row]) -> None:
        """Append rows and flush them to the disk; after a `DiskError` no row of the batch is in the file."""
        content = b"".join(json.dumps(row, allow_nan=False).encode() + b"\n" for row in batch)
        remedy = f"{self.count} finished runs are kept. Make room, then repeat the command to continue"
        with translate_disk_errors(self.path, kind=DiskError, remedy=remedy):
            try:
                rest = memoryview(content)
                while rest:
                    rest = rest[os.write(self._fd, rest) :]
                os.fsync(self._fd)
            except OSError:
                os.ftruncate(self._fd, self._end)
                raise
        self._end += len(content)
        self.count += len(batch)
