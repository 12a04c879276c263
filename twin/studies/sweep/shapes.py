"""What the files of a sweep's folder look like; whatever else somebody made of them is refused."""

import json
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field

MOST_RUNS = 20_000_000
"""Of a sweep; statistics have an entry for each of them."""
Whole = Annotated[int, Field(ge=-(2**63), lt=2**64)]


class _Shape(BaseModel):
    # another version may write more
    model_config = ConfigDict(extra="ignore", strict=True, allow_inf_nan=False)


class Facts(_Shape):
    """sweep.json; its keys as in `twin.studies.sweep.folder.Kept`, and what all runs have in common."""

    sweep: str
    runs: int = Field(ge=1, le=MOST_RUNS)
    design: str
    drives: list[str]
    labels: list[str]
    metrics: list[str]
    limits: dict[str, float]
    configuration: dict[str, str]


class Answer(_Shape):
    """What a run said to a claim."""

    verdict: str
    value: float | None


class Curves(_Shape):
    """What `twin.studies.sweep.curves.packed` makes; a run without any has an empty table."""

    period_s: float = Field(0.04, gt=0, le=1e6)
    of: dict[str, str] = Field(default_factory=dict)


class RowShape(_Shape):
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
    claims: dict[str, Answer] = Field(default_factory=dict)
    curves: Curves | None = None


def parsed(text: str | bytes, shape: type[BaseModel]) -> dict[str, Any] | None:
    """What the JSON in `text` says if it is of `shape`; None if not."""
    try:
        found = json.loads(text)
        shape.model_validate(found)
    # pydantic's ValidationError is a ValueError, too
    except (ValueError, RecursionError):
        return None
    return found
