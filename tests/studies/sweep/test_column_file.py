"""The copy of the columns is used where it fits and never believed where it does not; without it all is as with it."""

import json
import os
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.studies.sweep.statistics.rows import row
from twin.studies.sweep import column_file
from twin.studies.sweep.column_file import columns_in
from twin.studies.sweep.columns import Columns, Words
from twin.studies.sweep.rows import ROWS, Rows, read_columns

RUNS = 40


@pytest.fixture
def file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Rows of every kind of value, runs backwards; of so few there is usually no copy."""
    monkeypatch.setattr(column_file, "MANY", RUNS)
    rows = [
        row(n, {"a": n / 3, "b": [1, True, "x", 2.5][n % 4]}, [None, "one"][n % 2], peak_N=0.1 * n, end_N=None)
        | {"claims": {"trigger_time": {"verdict": "holds", "value": None}} if n % 3 else {}}
        for n in range(RUNS, 0, -1)
    ]
    rows[7] = row(RUNS - 7, {"a": 1.0})
    with Rows(tmp_path / ROWS) as there:
        there.add(rows)
    return tmp_path / ROWS


@pytest.fixture
def parsing(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """What is parsed from now on."""
    parsed: list[Path] = []

    def counted(path: Path) -> tuple[Columns, int]:
        parsed.append(path)
        return read_columns(path)

    monkeypatch.setattr(column_file, "read_columns", counted)
    return parsed


def copy_of(path: Path) -> Path:
    return path.with_suffix(column_file.SUFFIX)


def said(columns: Columns) -> dict[str, Any]:
    return {
        name: [(type(word), word) for word in one] if isinstance(one, Words) else one.tobytes()
        for name, one in columns.of.items()
        if name != "key"
    }


def test_a_copy_says_what_the_rows_say_and_spares_parsing_them(file: Path, parsing: list[Path]):
    first, again = columns_in(file), columns_in(file)
    assert parsing == [file] and copy_of(file).is_file()
    assert said(first) == said(again) == said(read_columns(file)[0].by_run())
    assert again.numbers("run").tolist() == list(range(1, RUNS + 1))
    # a program that goes on with the rows needs their keys
    assert columns_in(file, keys=True).words("key")[0] == "1" and len(parsing) == 2


def test_few_rows_have_no_copy(file: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(column_file, "MANY", RUNS + 1)
    columns_in(file)
    assert not copy_of(file).exists()


def appended(file: Path) -> None:
    then = file.stat().st_mtime_ns
    with Rows(file) as rows:
        rows.add([row(RUNS + 1, {})])
    os.utime(file, ns=(then, then))


def edited(file: Path) -> None:
    file.write_bytes(file.read_bytes().replace(b'"peak_N": 4.0', b'"peak_N": 7.0'))
    # a test is faster than the clock of a disk
    touched(file)


def touched(file: Path) -> None:
    os.utime(file, ns=(0, 1))


@pytest.mark.parametrize("change", [appended, edited, touched])
def test_a_copy_of_other_rows_is_not_used_but_made_anew(
    file: Path, parsing: list[Path], change: Callable[[Path], None]
):
    columns_in(file)
    change(file)
    assert said(columns_in(file)) == said(read_columns(file)[0].by_run())
    assert len(parsing) == 2
    columns_in(file)
    assert len(parsing) == 2


def test_a_copy_that_is_damaged_anywhere_is_no_error_and_not_believed(file: Path, parsing: list[Path]):
    right = said(columns_in(file))
    whole = copy_of(file).read_bytes()
    rng = np.random.default_rng(0)
    damaged = [b"", b"\n", b"{}\n", b"\0" * 50, whole[:-1], whole + b"\0", whole[whole.index(b"\n") :]]
    for place in rng.integers(len(whole), size=100):
        damaged.append(whole[:place] + bytes([whole[place] ^ (1 << rng.integers(8))]) + whole[place + 1 :])
    for number, content in enumerate(damaged, start=1):
        copy_of(file).write_bytes(content)
        found = said(columns_in(file))
        assert found == right
        assert len(parsing) == 1 + number


def forged(whole: bytes, change: Callable[[dict[str, Any]], None], value: bytes = b"") -> bytes:
    """A copy with other facts, or that begins with another number, and with the right sum of it."""
    head, _, body = whole[: -column_file.SUM].partition(b"\n")
    facts = json.loads(head)
    change(facts)
    text = json.dumps(facts).encode()
    content = text + b" " * (-(len(text) + 1) % 8) + b"\n" + value + body[len(value) :]
    return content + zlib.crc32(content).to_bytes(column_file.SUM)


def without_a_column(facts: dict[str, Any]) -> None:
    facts["columns"].pop("status")


def with_more_rows(facts: dict[str, Any]) -> None:
    facts["rows"] += 1


def with_too_few_words(facts: dict[str, Any]) -> None:
    facts["columns"]["parameters/b"].pop()


def with_a_status_that_is_a_number(facts: dict[str, Any]) -> None:
    facts["columns"]["status"][0] = 1


def with_another_layout(facts: dict[str, Any]) -> None:
    facts["layout"] = "0 little"


def with_claims_that_measured_nothing(facts: dict[str, Any]) -> None:
    facts["columns"] = {name.replace("values", "metrics"): words for name, words in facts["columns"].items()}


FORGERIES = (
    without_a_column, with_more_rows, with_too_few_words, with_a_status_that_is_a_number, with_another_layout,
    with_claims_that_measured_nothing,
)  # fmt: skip


@pytest.mark.parametrize("change", FORGERIES)
def test_a_copy_that_is_whole_but_no_copy_of_rows_is_not_believed(
    file: Path, parsing: list[Path], change: Callable[[dict[str, Any]], None]
):
    right = said(columns_in(file))
    whole = copy_of(file).read_bytes()
    copy_of(file).write_bytes(forged(whole, lambda facts: None))
    columns_in(file)
    assert len(parsing) == 1
    copy_of(file).write_bytes(forged(whole, change))
    assert said(columns_in(file)) == right and len(parsing) == 2


@pytest.mark.parametrize("run", [0.0, np.nan, np.inf, 30.0])
def test_runs_that_are_none_or_in_no_order_are_not_believed(file: Path, parsing: list[Path], run: float):
    right = said(columns_in(file))
    copy_of(file).write_bytes(forged(copy_of(file).read_bytes(), lambda facts: None, np.float64(run).tobytes()))
    assert said(columns_in(file)) == right and len(parsing) == 2


@pytest.mark.parametrize("obstacle", ["a folder", "a folder that is not ours"])
def test_where_no_copy_can_be_written_rows_are_read_all_the_same(
    file: Path, parsing: list[Path], monkeypatch: pytest.MonkeyPatch, obstacle: str
):
    if obstacle == "a folder":
        copy_of(file).mkdir()
    else:
        # whoever is root may write everywhere
        def refused(*args: Any, **kwargs: Any) -> None:
            raise PermissionError(13, "Permission denied")

        monkeypatch.setattr("tempfile.mkstemp", refused)
    assert len(columns_in(file)) == len(columns_in(file)) == RUNS
    assert parsing == [file, file] and not copy_of(file).is_file()
