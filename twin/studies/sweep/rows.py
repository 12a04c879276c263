"""The rows of a sweep on the disk: JSON lines, only ever appended to, safe after each batch."""

import json
import os
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

from twin.errors import ComponentFailed, InputRefused, disk_refusals
from twin.files import read_bytes

ROWS = "rows.jsonl"
LARGEST = 2**32
"""Bytes; a hundred thousand rows with curves take a quarter of it."""
Row = dict[str, Any]
MOST_RUNS = 20_000_000
"""Of a sweep; statistics have an entry for each of them."""
Whole = Annotated[int, Field(ge=-(2**63), lt=2**64)]


class Shape(BaseModel):
    """What a file of a sweep's folder looks like; whatever else somebody made of it is refused."""

    # another version may write more
    model_config = ConfigDict(extra="ignore", strict=True, allow_inf_nan=False)


class ClaimShape(Shape):
    """What a run said to a claim."""

    verdict: str
    value: float | None


class CurvesShape(Shape):
    """What `twin.studies.sweep.curves.packed` makes; a run without any has an empty table."""

    period_s: float = Field(0.04, gt=0, le=1e6)
    of: dict[str, str] = Field(default_factory=dict)


class RowShape(Shape):
    """A line of rows.jsonl."""

    run: int = Field(ge=1, le=MOST_RUNS)
    key: str
    drive: str | None
    parameters: dict[str, bool | Whole | float | str]
    status: str
    reason: str
    metrics: dict[str, float | None]
    within_limits: bool | None
    seconds: float | None
    stepping_s: float | None
    claims: dict[str, ClaimShape] = Field(default_factory=dict)
    curves: CurvesShape | None = None


def parsed(text: str | bytes, shape: type[BaseModel]) -> dict[str, Any] | None:
    """What the JSON in `text` says if it is of `shape`; None if not."""
    try:
        found = json.loads(text)
        shape.model_validate(found)
    # pydantic's ValidationError is a ValueError, too
    except (ValueError, RecursionError):
        return None
    return found


class DiskFailed(ComponentFailed):
    """A row could not be written; those before are kept."""


def read_rows(path: Path) -> tuple[list[Row], int]:
    """(whole rows of the file at `path`, bytes that they take up); what a power cut tore off after them is left out.

    Raises:
        InputRefused: it cannot be read, or a line in it is none of ours.
    """
    if not os.path.lexists(path):
        return [], 0
    content = read_bytes(path, LARGEST)
    end = content.rfind(b"\n") + 1
    rows: dict[str, Row] = {}
    for number, line in enumerate(content[:end].splitlines(), start=1):
        row = parsed(line, RowShape)
        if row is None:
            raise InputRefused(
                f"{path}: line {number} is no row of a sweep; remove the line, its run is then done again"
            )
        rows.setdefault(row["key"], row)
    return list(rows.values()), end


class Rows:
    """The file at `path`, open for more rows; a context manager. One process at a time has it.

    Attributes:
        rows: all of them, oldest first.

    Raises:
        InputRefused: it cannot be opened, is no file of rows, or another sweep writes to it.
    """

    def __init__(self, path: Path):
        # Windows has no fcntl, and no guarded processes either
        import fcntl

        self.path = path
        with disk_refusals(path, kind=InputRefused, remedy="choose another --out"):
            self._fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
        try:
            fcntl.flock(self._fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self.rows, self._end = read_rows(path)
        except BlockingIOError:
            os.close(self._fd)
            raise InputRefused(f"{path}: another twin sweep is writing there; wait for it, or choose --out") from None
        except InputRefused:
            os.close(self._fd)
            raise
        os.ftruncate(self._fd, self._end)

    def __enter__(self) -> "Rows":
        return self

    def __exit__(self, *failure: object) -> None:
        os.close(self._fd)

    def add(self, batch: list[Row]) -> None:
        """Append `batch`; when this returns, no crash and no power cut takes it back.

        Raises:
            DiskFailed: no space, or worse; nothing of the batch is in the file then.
        """
        content = b"".join(json.dumps(row, allow_nan=False).encode() + b"\n" for row in batch)
        kept = f"{len(self.rows)} finished runs are kept. Make room, then give the same command to go on"
        with disk_refusals(self.path, kind=DiskFailed, remedy=kept):
            try:
                rest = memoryview(content)
                while rest:
                    rest = rest[os.write(self._fd, rest) :]
                os.fsync(self._fd)
            except OSError:
                os.ftruncate(self._fd, self._end)
                raise
        self._end += len(content)
        self.rows += batch
