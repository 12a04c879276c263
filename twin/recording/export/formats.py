"""Signals as files of other tools: CSV (RFC 4180, but lines end with a line feed), Apache Parquet, MATLAB (level 5)."""

import csv
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from twin.errors import InputRefused, visible
from twin.recording.export.table import NANOSECONDS, Column, Table, message_times, numbers_of, row_times, topics_of
from twin.recording.recording import Recording
from twin.writing import write_bytes, written

FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""What a cell begins with that spreadsheets take for a formula."""
ROWS_AT_ONCE = 10_000
HEADER_BYTES = 116
"""Of descriptive text at the front of the file; scipy would write the date into it."""
LONGEST_NAME = 63
"""Letters that MATLAB reads of a name."""


def write_csv(path: Path, table: Table) -> None:
    """Write `table` to `path`; names carry the unit, numbers are the shortest that read back to the same float64.

    A name with a comma or a quote is quoted, one that spreadsheets would take for a formula begins with an apostrophe.
    Truth values are 0 and 1. Not a number is `nan`.

    Raises:
        NotWritten: it cannot be written.
    """
    columns = [table.t, *(column.values for column in table.columns)]
    with written(path) as beside, beside.open("w", encoding="utf-8", newline="\n") as file:
        csv.writer(file, lineterminator="\n").writerow(["t_s", *(_harmless(heading(c)) for c in table.columns)])
        # a number takes eight times the memory as a text
        for start in range(0, len(table.t), ROWS_AT_ONCE):
            texts = [_texts(values[start : start + ROWS_AT_ONCE]) for values in columns]
            file.writelines(",".join(row) + "\n" for row in zip(*texts, strict=True))


def heading(column: Column) -> str:
    """`plant.p_B[0]_m`, `plant.tau_l[0]_Nm`, `drive/1.omega_m_rad_per_s`: name and unit, like keys of TOML."""
    if column.unit == "1":
        return column.name
    return f"{column.name}_{column.unit.replace('N m', 'Nm').replace('/', '_per_').replace(' ', '_')}"


def write_parquet(path: Path, table: Table, metadata: Mapping[str, Mapping[str, str]]) -> None:
    """Write `table` to `path`: column `t` in s, then one column per number, each with `unit` and `meaning`.

    Args:
        metadata: of the recording, name -> key -> text; each name becomes one JSON text of the file's own metadata.

    Raises:
        InputRefused: pyarrow is not installed.
        NotWritten: it cannot be written.
    """
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise InputRefused("--parquet: needs pyarrow; install it with: pip install 'pyarrow>=17'") from None
    fields = [pa.field("t", pa.float64(), False, {"unit": "s", "meaning": "simulation time"})]
    arrays = [pa.array(table.t)]
    for column in table.columns:
        array = pa.array(column.values)
        fields.append(pa.field(column.name, array.type, False, {"unit": column.unit, "meaning": column.meaning}))
        arrays.append(array)
    origin = {name: json.dumps(dict(entries)) for name, entries in metadata.items()}
    with written(path) as beside:
        pq.write_table(pa.Table.from_arrays(arrays, schema=pa.schema(fields, origin)), beside, compression="zstd")


def write_matlab(path: Path, recording: Recording, signals: Sequence[str], rate: float | None = None) -> int:
    """Write `signals` to `path`: `plant.t` (n, 1) in s, `plant.p_B` (n, 3); `units.plant.p_B` is 'm'.

    Topic drive/1 becomes drive_1. Without a rate every topic keeps its own times; with one all have the rows of
    `table.table`.

    Args:
        signals: names `topic.field`, each with at least one message.
        rate: rows per second of simulated time (Hz).

    Raises:
        InputRefused: a rate that `table` refuses, or a name that MATLAB would cut.
        NotWritten: it cannot be written.
    """
    from scipy.io import savemat

    times = {topic: message_times(recording, topic) for topic in topics_of(signals)}
    common = row_times(list(times.values()), rate, numbers_of(recording, signals))
    structs: dict[str, dict[str, object]] = {}
    units: dict[str, dict[str, str]] = {}
    fields = recording.fields()
    for topic, own in times.items():
        rows = own if rate is None else common
        structs[_variable(topic)] = {"t": rows / NANOSECONDS}
        units[_variable(topic)] = {"t": "s"}
        picked = np.searchsorted(own, rows, side="right") - 1
        for name in (name for name in signals if name.rpartition(".")[0] == topic):
            field = fields[name]
            structs[_variable(topic)][_variable(field.name)] = recording[name][picked]
            units[_variable(topic)][field.name] = field.unit
    file = io.BytesIO()
    savemat(file, {**structs, "units": units}, long_field_names=True, do_compression=True, oned_as="column")
    text = f"MATLAB 5.0 MAT-file, written by twin from {recording.path.name}".encode("ascii", "replace")
    write_bytes(path, text[:HEADER_BYTES].ljust(HEADER_BYTES) + file.getvalue()[HEADER_BYTES:])
    return len(common)


def _harmless(name: str) -> str:
    """`name` as a cell that no spreadsheet calculates and no terminal obeys: names may be another tool's."""
    return f"'{visible(name)}" if name.startswith(FORMULA) else visible(name)


def _texts(values: np.ndarray) -> list[str]:
    return [repr(value) for value in (values.astype(int) if values.dtype == bool else values).tolist()]


def _variable(name: str) -> str:
    variable = name.replace("/", "_")
    if len(variable) > LONGEST_NAME:
        raise InputRefused(f"--mat: {name} is longer than the {LONGEST_NAME} letters MATLAB reads; leave it out")
    return variable
