from pathlib import Path
from typing import Any

import pytest

from tests.studies.sweep.statistics.rows import kept, row
from twin.studies.sweep.rows import write_parquet

pytest.importorskip("pyarrow")


@pytest.mark.parametrize(
    ("values", "kind", "written"),
    [
        ([1.5, None, 2.0], "double", [1.5, None, 2.0]),
        ([1, None, 3], "int64", [1, None, 3]),
        ([1, 2.5, None], "double", [1.0, 2.5, None]),
        ([True, False, None], "bool", [True, False, None]),
        ([True, 1, 2.5], "string", ["True", "1", "2.5"]),
        (["x", "1", None], "string", ["x", "1", None]),
        # half of a pair of code units, which a file's name may have
        (["x\udce4", "y", None], "string", ["x\\udce4", "y", None]),
    ],
)
def test_numbers_stay_numbers_and_what_is_mixed_becomes_text(
    tmp_path: Path, values: list[Any], kind: str, written: list[Any]
):
    import pyarrow.parquet as pq

    rows = [row(n, {} if value is None else {"a": value}, y=0.5 * n) for n, value in enumerate(values, start=1)]
    rows.append(row(4, {}))
    write_parquet(kept(rows, labels=("a", "never")), tmp_path / "rows.parquet")
    table = pq.read_table(tmp_path / "rows.parquet")
    assert str(table.schema.field("a").type) == kind and table["a"].to_pylist() == [*written, None]
    assert table["never"].null_count == 4
    assert table["run"].to_pylist() == [1, 2, 3, 4] and table["y"].to_pylist() == [0.5, 1.0, 1.5, None]
    assert table["key"].to_pylist() == ["1", "2", "3", "4"]
