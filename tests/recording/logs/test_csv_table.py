"""Whichever way a CSV file is read, at once or row by row, the numbers are the same."""

import random
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from twin.recording.logs import csv_table
from twin.recording.logs.csv_head import LARGEST
from twin.recording.logs.csv_table import CsvTable, read_table
from twin.recording.logs.errors import LogRefused


def table(tmp_path: Path, text: str) -> CsvTable:
    (tmp_path / "a.csv").write_text(text, newline="")
    return read_table(tmp_path / "a.csv")


def only_row_by_row(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(csv_table, "_at_once", lambda *arguments: None)


@pytest.mark.parametrize(
    "text",
    [
        "t_s,F_N\n0,1\n1,2\n",
        "t_s,F_N\r\n0,1\r\n1,2",
        "# a\n\n# b\nt_s;F_N;state\n0;1.5;up\n1;-2e-3;down\n2; 3 ;\n",
        't_s,"F, in N"\n0,"1"\n 1 , 2\n',
        "t_s\tF_N\n0\t.5\n1\t1e5\n",
        "t_s,F_N,x\n0,1,n/a\n1,2,3\n",
        "t_s,F_N\n0,1\n\n1,2\n",
        '"t\ns",F_N\n0,1\n1,2\n',
        "t_s,F_N\n0,1_0\n1,nan\n",
        f"t_s,F_N\n0,{LARGEST!r}\n1,-1e308\n",
    ],
)
def test_both_ways_give_the_same_table(tmp_path: Path, text: str, monkeypatch: pytest.MonkeyPatch):
    one = table(tmp_path, text)
    only_row_by_row(monkeypatch)
    other = table(tmp_path, text)
    assert (one.head, one.comments, one.wrong) == (other.head, other.comments, other.wrong)
    np.testing.assert_array_equal(one.values, other.values)
    assert one.lines.tolist() == other.lines.tolist()


def test_random_numbers_come_back_to_the_last_bit_both_ways(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    rng = random.Random(7)
    rows = [[k, rng.gauss(0, 1), rng.uniform(-1, 1) * 10 ** rng.randint(-300, 90)] for k in range(500)]
    text = "t_s,a,b\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows)
    assert table(tmp_path, text).values.tolist() == rows
    only_row_by_row(monkeypatch)
    assert table(tmp_path, text).values.tolist() == rows


@pytest.mark.parametrize("cell", ["1e308", "-1e101", "nan", "inf", "9" * 400])
def test_a_number_that_no_quantity_has_is_none(tmp_path: Path, cell: str):
    wrong = table(tmp_path, f"t_s,F_N\n0,1\n1,{cell}\n2,3\n").mistakes("F_N")
    assert wrong is not None and (wrong.count, wrong.line, wrong.text) == (1, 3, cell)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"\x89PNG\r\n\x1a\n", "a PNG picture; expected CSV in UTF-8"),
        ("t_s,F_N\n0,1\n".encode("utf-16"), "text in UTF-16; expected CSV in UTF-8"),
        (b"t_s," + b",".join(b"a%d" % i for i in range(3000)) + b"\n", "3,001 columns, expected at most 2,000"),
        (b"t_s,F\n" + b"0,1\n" * 300_000 + b"0,\xff\n", "byte 1200008 is not UTF-8"),
    ],
)
def test_what_is_no_log_is_told_for_what_it_is(tmp_path: Path, content: bytes, said: str):
    (tmp_path / "a.csv").write_bytes(content)
    with pytest.raises(LogRefused, match=said):
        read_table(tmp_path / "a.csv")


@pytest.mark.parametrize("rows", [20_000, pytest.param(200_000, marks=pytest.mark.endurance)])
@pytest.mark.parametrize("last", ["1.5", "x"])
def test_a_long_log_of_36_columns_takes_little_time_and_memory(tmp_path: Path, rows: int, last: str):
    line = ",".join(f"{1.23456789 * k:.8f}" for k in range(35))
    with (tmp_path / "a.csv").open("w") as file:
        file.write("t_s," + ",".join(f"a{k}_N" for k in range(35)) + "\n")
        file.writelines(f"{0.001 * k:.3f},{line}\n" for k in range(rows - 1))
        file.write(f"1e9,{line.rpartition(',')[0]},{last}\n")
    tracemalloc.start()
    began = time.process_time()
    try:
        assert len(read_table(tmp_path / "a.csv").values) == rows
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    # 8 bytes a number, and as much again while they are gathered; lists of texts took 300
    assert peak < 3 * 8 * 36 * rows + 10e6
    # a second for 200,000 rows at once, four row by row, on an idle machine; tracing memory takes its time, too
    assert time.process_time() - began < 30.0 * rows / 200_000 + 2.0


def test_a_log_as_it_should_be_with_words_in_it_is_read_at_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(csv_table, "_row_by_row", lambda *arguments: pytest.fail("read row by row"))
    found = table(tmp_path, "# a\nt_s,F_N,state,seen\n0,1,up,\n1,2,down,\n")
    assert [found.is_words(name) for name in found.head] == [False, False, True, False]
    assert found.lines.tolist() == [3, 4]
