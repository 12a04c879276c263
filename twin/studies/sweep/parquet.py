"""The rows of a sweep as one Apache Parquet file: a column per parameter and metric."""

from pathlib import Path
from typing import Any

from twin.errors import InputRefused
from twin.studies.sweep.folder import KeptRows
from twin.writing import written


def write_parquet(kept: KeptRows, path: Path) -> None:
    """Write `kept` to `path`, a line per run in the order of runs: the same rows make the same bytes.

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
        raise InputRefused("--parquet: needs pyarrow; install it with: pip install 'twin[parquet]'") from None
    columns: dict[str, list[Any]] = {name: [row[name] for row in kept.rows] for name in ("run", "drive")}
    for label in kept.labels:
        values = [row["parameters"].get(label) for row in kept.rows]
        kinds = {type(value) for value in values if value is not None}
        # a column has one type: numbers stay numbers, anything mixed becomes text
        uniform = kinds <= {int, float} or len(kinds) == 1
        columns[label] = [value if uniform or value is None else str(value) for value in values]
    columns |= {metric: [row["metrics"].get(metric) for row in kept.rows] for metric in kept.metrics}
    for name in ("status", "reason", "within_limits", "seconds", "stepping_s", "key"):
        columns[name] = [row[name] for row in kept.rows]
    with written(path) as beside:
        pq.write_table(pa.table({name: _array(pa, values) for name, values in columns.items()}), beside)


def _array(pa: Any, values: list[Any]) -> Any:
    floats = any(isinstance(value, float) for value in values)
    return pa.array([float(v) if floats and v is not None else v for v in values])
