"""A table as comma-separated values (RFC 4180, but lines end with a line feed): one header, one row per instant."""

import csv
from pathlib import Path

import numpy as np

from twin.errors import visible
from twin.recording.export.table import Column, Table
from twin.writing import written

FORMULA = ("=", "+", "-", "@", "\t", "\r")
"""What a cell begins with that spreadsheets take for a formula."""


def write_csv(path: Path, table: Table) -> None:
    """Write `table` to `path`; names carry the unit, numbers are the shortest that read back to the same float64.

    A name with a comma or a quote is quoted, one that spreadsheets would take for a formula begins with an apostrophe.
    Truth values are 0 and 1. Not a number is `nan`.

    Raises:
        NotWritten: it cannot be written.
    """
    columns = [_texts(table.t), *(_texts(column.values) for column in table.columns)]
    with written(path) as beside, beside.open("w", encoding="utf-8", newline="\n") as file:
        csv.writer(file, lineterminator="\n").writerow(["t_s", *(_harmless(heading(c)) for c in table.columns)])
        file.writelines(",".join(row) + "\n" for row in zip(*columns, strict=True))


def heading(column: Column) -> str:
    """`plant.p_B[0]_m`, `plant.tau_l[0]_Nm`, `drive/1.omega_m_rad_per_s`: name and unit, like keys of TOML."""
    if column.unit == "1":
        return column.name
    return f"{column.name}_{column.unit.replace('N m', 'Nm').replace('/', '_per_').replace(' ', '_')}"


def _harmless(name: str) -> str:
    """`name` as a cell that no spreadsheet calculates and no terminal obeys: names may be another tool's."""
    return f"'{visible(name)}" if name.startswith(FORMULA) else visible(name)


def _texts(values: np.ndarray) -> list[str]:
    return [repr(value) for value in (values.astype(int) if values.dtype == bool else values).tolist()]
