"""Rows survive a crash at any byte, a full disk, and are never mixed up or counted twice."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.kernel.recording.test_writer import largest_file
from tests.studies.sweep.statistics import rows as made_up
from tests.studies.sweep.statistics.rows import kept, row
from twin.kernel.errors import InputRefused
from twin.studies.sweep.columns import (
    CategoricalColumn,
    Columns,
    Row,
    cache_per_columns,
    columns_of,
    concatenate_columns,
)
from twin.studies.sweep.parquet import write_parquet
from twin.studies.sweep.rows import DiskError, RowFile, read_columns, read_rows

VALUES = st.one_of(st.booleans(), st.integers(-3, 3), st.floats(-3.0, 3.0), st.sampled_from(["", "1", "x"]))
TABLES = st.dictionaries(st.sampled_from("abc"), VALUES, max_size=3)
METRICS = st.dictionaries(st.sampled_from(["y", "z"]), st.one_of(st.none(), st.floats(-3.0, 3.0)))
CLAIM = st.fixed_dictionaries({"verdict": st.sampled_from(["holds", "fails"]), "value": st.none() | st.floats(0, 1)})


@st.composite
def rows(draw: st.DrawFn) -> list[Row]:
    """Rows in any order of runs, each with parameters, metrics and claims of its own."""
    return [
        row(run, draw(TABLES), draw(st.sampled_from([None, "one", "other"])), "done", **draw(METRICS))
        | {"claims": draw(st.dictionaries(st.just("trigger_time"), CLAIM)), "curves": draw(st.sampled_from([None, {}]))}
        for run in draw(st.permutations(range(1, draw(st.integers(1, 8)))))
    ]


def typed(values: list[Any]) -> list[tuple[type, Any]]:
    return [(type(value), value) for value in values]


def said(columns: Columns, name: str) -> list[Any]:
    """A column with None where the row has nothing, also where the column is not there."""
    column = columns.by_name.get(name, CategoricalColumn.from_values([None] * len(columns)))
    if isinstance(column, CategoricalColumn):
        return typed(list(column))
    return typed([None if np.isnan(number) else number for number in column.tolist()])


@pytest.mark.slow
@given(rows(), rows())
def test_each_column_is_what_the_rows_say_also_if_they_come_in_parts(first: list[Row], then: list[Row]):
    columns, both = concatenate_columns([columns_of(first), columns_of(then)]), [*first, *then]
    assert len(columns) == len(both)
    for name in ("drive", "status", "reason", "within_limits", "key"):
        assert said(columns, name) == typed([one[name] for one in both])
    for label in "abc":
        assert said(columns, f"parameters/{label}") == typed([one["parameters"].get(label) for one in both])
    for metric in "yz":
        assert said(columns, f"metrics/{metric}") == typed([one["metrics"].get(metric) for one in both])
    answers = [one["claims"].get("trigger_time", {}) for one in both]
    assert said(columns, "verdicts/trigger_time") == typed([answer.get("verdict") for answer in answers])
    assert said(columns, "values/trigger_time") == typed([answer.get("value") for answer in answers])
    assert list(columns.categorical("has_metrics")) == [bool(one["metrics"]) for one in both]


@pytest.mark.slow
@given(rows())
def test_in_the_order_of_runs_every_row_keeps_its_values(some: list[Row]):
    columns, ordered = columns_of(some).by_run(), sorted(some, key=lambda one: one["run"])
    assert [columns.run_number(n) for n in range(len(columns))] == [one["run"] for one in ordered]
    assert list(columns.categorical("drive")) == [one["drive"] for one in ordered]


def test_words_are_counted_in_the_order_of_rows_and_those_that_no_row_has_any_more_are_not():
    words = CategoricalColumn.from_values(["b", "a", None, "b"])
    assert list(words.counts.items()) == [("b", 2), ("a", 1), (None, 1)]
    assert words.select(np.array([1, 2])).counts == {"a": 1, None: 1}
    assert words.mask(lambda word: word == "b").tolist() == [True, False, False, True]


def test_what_was_found_out_of_columns_is_not_found_out_again():
    asked = []

    @cache_per_columns
    def length(columns: Columns, more: int) -> int:
        asked.append(more)
        return len(columns) + more

    columns, other = columns_of([row(1, {})]), columns_of([])
    assert [length(columns, 1), length(columns, 1), length(columns, 2), length(other, 1)] == [2, 2, 3, 1]
    assert asked == [1, 2, 1]


def keyed_row(number: int) -> dict:
    return {**made_up.row(number, {}, peak_N=0.1 * number, end_N=None), "key": f"k{number}", "reason": "ü\n"}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    with RowFile(tmp_path / "rows.jsonl") as rows:
        rows.add([keyed_row(1), keyed_row(2)])
        rows.add([keyed_row(3)])
    return tmp_path / "rows.jsonl"


def test_what_is_added_is_read_again(file: Path):
    assert read_rows(file) == [keyed_row(1), keyed_row(2), keyed_row(3)]
    columns, end = read_columns(file)
    assert columns.numbers("run").tolist() == [1, 2, 3] and end == file.stat().st_size


def test_a_line_torn_at_any_byte_is_dropped_and_its_run_can_be_added_again(file: Path):
    whole = file.read_bytes()
    begins = whole[:-1].rindex(b"\n") + 1
    for end in range(begins, len(whole)):
        file.write_bytes(whole[:end])
        with RowFile(file) as rows:
            assert list(rows.before.categorical("key")) == ["k1", "k2"] and rows.count == 2
            rows.add([keyed_row(3)])
        assert file.read_bytes() == whole


def test_a_row_that_is_there_twice_counts_once(file: Path):
    content = file.read_bytes()
    file.write_bytes(content + content.replace(b'"done"', b'"tripped"'))
    assert read_rows(file) == [keyed_row(1), keyed_row(2), keyed_row(3)]
    columns, end = read_columns(file)
    assert list(columns.categorical("key")) == ["k1", "k2", "k3"] and columns.categorical("status").counts == {
        "done": 3
    }
    # its bytes are not cut off
    assert end == file.stat().st_size


def test_a_line_that_is_no_row_is_refused_with_its_number(file: Path):
    lines = file.read_bytes().splitlines(keepends=True)
    for damaged in (b"\0\0\0\n", b"{}\n", b"[1]\n", b'"key"\n'):
        file.write_bytes(lines[0] + damaged + lines[2])
        with pytest.raises(InputRefused, match="line 2 is no row of a sweep"):
            RowFile(file)


def test_what_json_of_python_alone_can_read_and_what_another_version_wrote_more_is_a_row(file: Path):
    # half of a pair of code units: of a file's name that is no text in UTF-8
    odd = {**keyed_row(4), "reason": "no such file: \udce4", "of_another_version": {"a": 1}}
    with RowFile(file) as rows:
        rows.add([odd])
    assert read_rows(file)[-1] == odd
    assert read_columns(file)[0].categorical("reason")[3] == odd["reason"]


@pytest.mark.parametrize("spare", [0, 1, 150])
def test_a_full_disk_keeps_every_row_before_and_room_lets_it_go_on(file: Path, spare: int):
    before = file.read_bytes()
    with RowFile(file) as rows:
        with largest_file(len(before) + spare), pytest.raises(DiskError, match="3 finished runs are kept"):
            rows.add([keyed_row(4), keyed_row(5)])
        assert file.read_bytes() == before
        rows.add([keyed_row(4)])
    assert read_rows(file) == [keyed_row(number) for number in range(1, 5)]


def test_two_sweeps_never_write_to_the_same_file(file: Path):
    with RowFile(file), pytest.raises(InputRefused, match="another twin sweep is writing there"):
        RowFile(file)


def test_a_number_that_json_does_not_have_is_never_written(file: Path):
    before = file.read_bytes()
    with RowFile(file) as rows, pytest.raises(ValueError, match="JSON"):
        rows.add([{"key": "k9", "metrics": {"peak_N": float("nan")}}])
    assert file.read_bytes() == before
    assert all(json.loads(line) for line in before.splitlines())


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
