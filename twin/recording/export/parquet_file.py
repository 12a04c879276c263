"""A table as Apache Parquet: units and meanings in the columns' metadata, the run's origin in the file's."""

import json
from collections.abc import Mapping
from pathlib import Path

from twin.errors import InputRefused
from twin.recording.export.table import Table
from twin.writing import written


def write_parquet(path: Path, table: Table, metadata: Mapping[str, Mapping[str, str]]) -> None:
    """Write `table` to `path`: column `t` in s, then one column per number, each with `unit` and `meaning`.

    Args:
        path: of the file. table: what goes into it.
        metadata: of the recording, name -> key -> text; each name becomes one JSON text of the file's own metadata.

    Raises:
        InputRefused: pyarrow is not installed.
        NotWritten: it cannot be written.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise InputRefused("--parquet: needs pyarrow; install it with: pip install 'twin[parquet]'") from None
    fields = [pa.field("t", pa.float64(), False, {"unit": "s", "meaning": "simulation time"})]
    arrays = [pa.array(table.t)]
    for column in table.columns:
        array = pa.array(column.values)
        fields.append(pa.field(column.name, array.type, False, {"unit": column.unit, "meaning": column.meaning}))
        arrays.append(array)
    origin = {name: json.dumps(dict(entries)) for name, entries in metadata.items()}
    with written(path) as beside:
        pq.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields, origin)), beside, compression="zstd")
