"""Rows of a sweep made up for tests."""

from typing import Any

from twin.studies.sweep.columns import Row, columns_of
from twin.studies.sweep.stored import SweepRows


def row(run: int, parameters: dict[str, Any], drive: str | None = None, status: str = "done", **metrics: Any) -> Row:
    """A row; without metrics it has not come to its end."""
    return {
        "run": run,
        "key": str(run),
        "drive": drive,
        "parameters": parameters,
        "status": status if metrics else "failed",
        "reason": "" if metrics else "drive_1: it crashed",
        "metrics": metrics,
        "within_limits": None,
        "seconds": 0.1,
        "stepping_s": 0.1,
    }


def kept(rows: list[Row], **facts: Any) -> SweepRows:
    """A folder with these rows."""
    labels = tuple(dict.fromkeys(label for one in rows for label in one["parameters"]))
    drives = tuple(drive for drive in dict.fromkeys(one["drive"] for one in rows) if drive)
    metrics = tuple(dict.fromkeys(metric for one in rows for metric in one["metrics"]))
    usual = {"name": "made_up", "runs": len(rows), "design": "random", "drives": drives, "labels": labels}
    read = {"columns": columns_of(rows).by_run(), "read": lambda: rows}
    return SweepRows(**{**usual, "metrics": metrics, "limits": {}, **read, **facts})
