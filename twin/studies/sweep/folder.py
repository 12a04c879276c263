"""The folder of a sweep: definition, rows, recordings, Parquet; whether it may be continued."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import Field

from twin.kernel.errors import InputRefused
from twin.kernel.files import read_bytes
from twin.kernel.writing import made_folder, write_json, written
from twin.studies.sweep.rows import (
    MOST_RUNS,
    ROWS,
    Column,
    Columns,
    FileShape,
    Row,
    Words,
    parsed,
    read_columns,
    read_rows,
)

if TYPE_CHECKING:
    from twin.studies.sweep.plan import SweepPlan


HOME = Path("results/sweeps")
FACTS = "sweep.json"


class Facts(FileShape):
    """sweep.json; its keys as in `SweepRows`, and what all runs have in common."""

    sweep: str
    runs: int = Field(ge=1, le=MOST_RUNS)
    design: str
    drives: list[str]
    labels: list[str]
    metrics: list[str]
    limits: dict[str, float]
    configuration: dict[str, str]


@dataclass(frozen=True)
class SweepRows:
    """What a folder holds.

    Attributes:
        name: of the sweep.
        runs: planned, of all drives.
        design, drives, limits: see `Definition`.
        labels: what varies, in the order of the file.
        metrics: that a run may have.
        columns: rows of finished runs, by run.
        read: reads these rows as they are written.
    """

    name: str
    runs: int
    design: str
    drives: tuple[str, ...]
    labels: tuple[str, ...]
    metrics: tuple[str, ...]
    limits: dict[str, float]
    columns: Columns
    read: Callable[[], list[Row]]

    @cached_property
    def rows(self) -> list[Row]:
        """As they are written, with curves, by run: for what needs more than columns, as it takes ten times as long."""
        return sorted(self.read(), key=lambda row: row["run"])


def claim(folder: Path, plan: "SweepPlan") -> None:
    """Make `folder` that of `plan`, or find that it is already.

    Raises:
        InputRefused: it is another sweep's, or cannot be made.
        NotWritten: the disk refuses.
    """
    facts = _read(folder)
    if facts:
        changed = [what for what, digest in plan.configuration.items() if facts["configuration"].get(what) != digest]
        if changed:
            raise InputRefused(
                f"{folder}: holds rows of another configuration, since then {' and '.join(changed)} changed; "
                "rows of both must not be mixed: choose another --out, or move the folder away"
            )
        return
    content = {
        "sweep": plan.name,
        "experiment": plan.experiment.name,
        "runs": len(plan.tasks),
        "design": plan.definition.design,
        "drives": plan.definition.drives,
        "labels": [vary.label for vary in plan.definition.vary],
        "metrics": plan.metrics,
        "limits": plan.definition.limits,
        "configuration": plan.configuration,
    }
    made_folder(folder)
    if (folder / ROWS).exists():
        raise InputRefused(f"{folder}: has rows but no {FACTS}, which describes them; choose another --out")
    write_json(folder / FACTS, content)


def stored_sweep(folder: Path) -> SweepRows:
    """What is in `folder`.

    Raises:
        InputRefused: no sweep's, or as `read_columns`.
    """
    facts = _read(folder)
    if not facts:
        raise InputRefused(f"{folder}: not the folder of a sweep, {FACTS} is missing; begin with twin sweep SWEEP.toml")
    path = folder / ROWS
    columns = read_columns(path)[0].by_run()
    lists = {name: tuple(facts[name]) for name in ("drives", "labels", "metrics")}
    return SweepRows(
        facts["sweep"], facts["runs"], facts["design"], limits=facts["limits"],
        columns=columns, read=lambda: read_rows(path), **lists,
    )  # fmt: skip


def _read(folder: Path) -> dict[str, Any]:
    """The facts of `folder`; empty if there are none."""
    path = folder / FACTS
    if not os.path.lexists(path):
        return {}
    facts = parsed(read_bytes(path), Facts)
    if facts is None:
        raise InputRefused(f"{path}: not what twin sweep writes; choose another --out")
    return facts


def write_parquet(sweep: SweepRows, path: Path) -> None:
    """Write `sweep` to `path`, a line per run in the order of runs: the same rows make the same bytes.

    Columns: run, drive, each parameter by its key, each metric, status, reason, within_limits, seconds, stepping_s,
    key. What a run has not is null.

    Raises:
        InputRefused: pyarrow is not installed.
        NotWritten: the file cannot be written.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise InputRefused("--parquet: needs pyarrow; install it with: pip install 'pyarrow>=17'") from None
    columns = sweep.columns
    table = {"run": pa.array(columns.numbers("run").astype(int))}
    named = [("drive", "drive"), *((label, f"parameters/{label}") for label in sweep.labels)]
    named += [(metric, f"metrics/{metric}") for metric in sweep.metrics]
    named += [(name, name) for name in ("status", "reason", "within_limits", "seconds", "stepping_s", "key")]
    table |= {title: _array(pa, columns.of.get(name), len(columns)) for title, name in named}
    with written(path) as beside:
        pq.write_table(pa.table(table), beside)


def _array(pa: Any, column: Column | None, rows: int) -> Any:
    if isinstance(column, Words):
        kinds = {type(word) for word in column.words if word is not None}
        # a column has one type: numbers stay numbers, anything mixed becomes text
        one = float if kinds == {int, float} else str if len(kinds) > 1 else None
        words = [word if word is None or one is None else one(word) for word in column.words]
        # a file's name that is no text in UTF-8 may be in a reason
        words = [word.encode(errors="backslashreplace").decode() if isinstance(word, str) else word for word in words]
        return pa.array(words).take(pa.array(column.codes))
    if column is None or np.isnan(column).all():
        return pa.nulls(rows)
    return pa.array(column, from_pandas=True)
