"""The rows of a sweep as a Parquet file."""

from pathlib import Path
from typing import Any

import numpy as np

from twin.kernel.atomic_write import atomic_write
from twin.kernel.errors import InputRefused
from twin.studies.sweep.columns import CategoricalColumn, Column
from twin.studies.sweep.stored import SweepRows


def write_parquet(sweep: SweepRows, path: Path) -> None:
    """Write the rows of `sweep` to a Parquet file, one per run in the order of runs; equal rows give equal bytes.

    Columns: run, drive, each parameter by its key, each metric, status, reason, within_limits, seconds, stepping_s,
    key. Missing values are null.
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
    table |= {title: _array(pa, columns.by_name.get(name), len(columns)) for title, name in named}
    with atomic_write(path) as beside:
        pq.write_table(pa.table(table), beside)


def _array(pa: Any, column: Column | None, rows: int) -> Any:
    if isinstance(column, CategoricalColumn):
        kinds = {type(word) for word in column.categories if word is not None}
        # A Parquet column has one type: numbers stay numbers, mixed types become text.
        one = float if kinds == {int, float} else str if len(kinds) > 1 else None
        words = [word if word is None or one is None else one(word) for word in column.categories]
        # A reason may contain a file name that is not valid UTF-8.
        words = [word.encode(errors="backslashreplace").decode() if isinstance(word, str) else word for word in words]
        return pa.array(words).take(pa.array(column.codes))
    if column is None or np.isnan(column).all():
        return pa.nulls(rows)
    return pa.array(column, from_pandas=True)
