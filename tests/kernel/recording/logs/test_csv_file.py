import random
import time
import tracemalloc
from pathlib import Path

import numpy as np
import pytest

from twin.kernel.errors import InputRefused
from twin.kernel.recording.logs import csv_table
from twin.kernel.recording.logs.column_map import column_map
from twin.kernel.recording.logs.csv_table import CsvTable, read_table
from twin.kernel.recording.logs.log import MAX_QUANTITY, Log, LogError
from twin.kernel.recording.logs.reader import read_log


def log_of(tmp_path: Path, text: str | bytes, *maps: str) -> Log:
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode() if isinstance(text, str) else text)
    return read_log(path, column_map(maps))


def refusal(tmp_path: Path, text: str | bytes, *maps: str) -> str:
    with pytest.raises(LogError) as refused:
        log_of(tmp_path, text, *maps)
    return str(refused.value).replace(f"{tmp_path}/", "")


def test_the_head_names_signals_and_units_and_values_come_out_in_si(tmp_path: Path):
    log = log_of(tmp_path, "t_ms,controller.F_z_N,plant.p_B[2]_mm,speed (rpm)\n0,1,-101,60\n2,2,-105,-60\n")
    assert log["controller.F_z"].values.tolist() == [1.0, 2.0]
    assert log["plant.p_B[2]"].values.tolist() == [-0.101, -0.105]
    np.testing.assert_allclose(log["speed"].values, [2 * np.pi, -2 * np.pi], rtol=1e-15)
    assert [series.unit for series in log.series.values()] == ["N", "m", "rad/s"]
    assert log["controller.F_z"].t.tolist() == [0.0, 0.002]


def test_separators_quotes_blank_lines_byte_order_marks_and_line_ends_do_not_matter(tmp_path: Path):
    plain = log_of(tmp_path, "t_s,F_N\n0,1\n1,2\n")
    for text in (
        "\ufefft_s,F_N\r\n0,1\r\n1,2\r\n",
        't_s;F_N\n0;"1"\n\n1;2\n\n',
        "t_s\tF_N\n0\t1\n1\t2",
        " t_s , F_N\n 0 , 1\n 1, 2\n",
    ):
        assert log_of(tmp_path, text)["F"].values.tolist() == plain["F"].values.tolist()


def test_comments_before_the_head_are_kept(tmp_path: Path):
    assert log_of(tmp_path, "# from the scope\n#\n# run 7\nt_s,F_N\n0,1\n1,2\n").comments == (
        "from the scope",
        "",
        "run 7",
    )


def test_a_map_chooses_columns_units_and_signs_and_leaves_the_rest_unread(tmp_path: Path):
    text = "stamp,Fz,state,empty\n0,1,a,\n1,2,b,\n"
    log = log_of(tmp_path, text, "time=stamp[ms]", "scale.F_z=-Fz[gf]")
    assert list(log.series) == ["scale.F_z"]
    np.testing.assert_allclose(log["scale.F_z"].values, [-0.00980665, -0.0196133], rtol=1e-15)


def test_columns_of_words_are_left_out_and_named(tmp_path: Path):
    log = log_of(tmp_path, "t_s,F_N,state\n0,1,up\n1,2,down\n")
    assert list(log.series) == ["F"]
    assert log.notes == ("columns of words are left out: state",)


def test_a_motor_angle_without_unit_is_not_taken_for_metres(tmp_path: Path):
    log = log_of(tmp_path, "t_s,theta_m,encoder.count_m,z_m\n0,1,2,3\n1,1,2,3\n")
    assert {name: series.unit for name, series in log.series.items()} == {
        "theta_m": "1",
        "encoder.count_m": "1",
        "z": "m",
    }


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "a.csv: an empty file; expected a line of names, then rows of numbers"),
        ("# nothing\n", "a.csv: only comments; expected a line of names, then rows of numbers"),
        ("t_s,F_N\n", "a.csv: 0 rows of numbers, expected at least 2"),
        ("t_s,F_N\n0,1\n", "a.csv: 1 row of numbers, expected at least 2"),
        ("0,1\n1,2\n", "a.csv line 1: numbers where the names of the columns are expected"),
        ("F_N\n1\n2\n", "a.csv: one column, 'F_N'; expected the time and at least one signal"),
        ("t_s,F_N,F_N\n0,1,1\n1,1,1\n", "a.csv: two columns are named 'F_N'; expected different names"),
        ("t_s,F_N,F_mN\n0,1,1\n1,1,1\n", "a.csv: columns 'F_N' and 'F_mN' are both F; use --map"),
        ("t_s,F_N\n0,1\n1\n2,3\n3\n", "a.csv line 3: 1 field, expected 2 (and 1 more such row)"),
        ("t_s,F_N\n0,1\n1,3,14\n", "a.csv line 3: 3 fields, expected 2; are there decimal commas? Export with points"),
        (
            "t_s;F_N\n0;3,14\n1;2\n",
            "a.csv line 2: column 'F_N' holds '3,14', expected a number; decimal commas? Export with points",
        ),
        ("# a\nt_s,F_N\n0,1\n1,nan\n", "a.csv: column 'F_N' has 1 number, expected at least 2"),
        ("t_s,F_N\n0,1\n1,inf\n2,-inf\n", "a.csv: column 'F_N' has 1 number, expected at least 2"),
        ("t_s,F_N\n0,\n1,2\n", "a.csv: column 'F_N' has 1 number, expected at least 2"),
        ("t_s,F_N\n0,1\n1,off\n2,on\n", "a.csv line 3: column 'F_N' holds 'off', expected a number (and 1 more"),
        ("t_s,F_N\n0,1\n,2\n", "a.csv: time column 't_s' has 1 time, expected at least 2"),
        (
            "time,F_N\n2025-05-01 12:00:00.1,1\n2025-05-01 12:00:00.2,2\n",
            "a.csv line 2: time column 'time' holds the date or time of day '2025-05-01 12:00:00.1'; expected seconds",
        ),
        ("t_s,F_N\n12:00:00,1\n12:00:01,2\n", "a.csv line 2: time column 't_s' holds the date or time of day '12:00"),
        ("stamp,F_N\n01.05.2025 12:00,1\n", "a.csv: 1 row of numbers, expected at least 2"),
        ("t_s,F_N\n0,1\n0,2\n", "a.csv line 3: time 't_s' repeats 0 s, expected ascending times"),
        ("t_s,F_N\n1,1\n\n0,2\n", "a.csv line 4: time 't_s' runs backwards from 1 s to 0 s, expected ascending times"),
        ("t,F_N\n0,1\n1,2\n", "a.csv: time column 't' has no unit; expected s, ms, us, ns or min"),
        ("t_N,F_N\n0,1\n1,2\n", "a.csv: time column 't_N' has unit 'N'; expected s, ms, us, ns or min"),
        ("t_s,F (lbs)\n0,1\n1,2\n", "a.csv: column 'F (lbs)': unknown unit 'lbs'"),
        ("stamp,F_N\n0,1\n1,2\n", "a.csv: no column of time; it has stamp, F_N; choose with --map time=COLUMN[UNIT]"),
        (b"t_s,\xb0\n0,1\n", "a.csv: byte 4 is not UTF-8; save it as CSV in UTF-8"),
        (b"\x00\x01\x02 \n", "a.csv: not a text file; expected CSV or MCAP"),
    ],
)
def test_what_is_wrong_with_a_file_is_one_sentence_with_its_line(tmp_path: Path, text: str | bytes, expected: str):
    found = refusal(tmp_path, text)
    assert found.startswith(expected)
    assert len(found.splitlines()) == 1


def test_a_column_that_is_not_there_is_named_with_the_nearest(tmp_path: Path):
    text = "stamp,Fz\n0,1\n1,2\n"
    assert refusal(tmp_path, text, "time=stmp[s]", "scale.F_z=Fy[N]") == (
        "a.csv: column 'stmp' for time is not there; did you mean 'stamp'?\n"
        "a.csv: column 'Fy' for scale.F_z is not there; did you mean 'Fz'?"
    )


def test_a_log_without_a_signal_is_refused(tmp_path: Path):
    text = "stamp,Fz\n0,1\n1,2\n"
    assert refusal(tmp_path, text, "time=stamp[ms]").startswith("a.csv: the map names no signal other than the time")
    words = "t_s,state\n0,up\n1,down\n"
    assert refusal(tmp_path, words).startswith("a.csv: no column of numbers other than the time")


def test_every_mistake_is_told_at_once(tmp_path: Path):
    found = refusal(tmp_path, "t_s,a_N,b_N\n0,1,x\n0,2,3\n1,off,4\n")
    assert [line.partition(":")[0] for line in found.splitlines()] == ["a.csv line 3", "a.csv line 4", "a.csv line 2"]


def test_a_file_that_is_not_there_is_refused(tmp_path: Path):
    with pytest.raises(InputRefused, match=r"nowhere.csv: no such file"):
        read_log(tmp_path / "nowhere.csv")


def table(tmp_path: Path, text: str) -> CsvTable:
    (tmp_path / "a.csv").write_text(text, newline="")
    return read_table(tmp_path / "a.csv")


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
        f"t_s,F_N\n0,{MAX_QUANTITY!r}\n1,-1e308\n",
    ],
)
def test_the_table_is_the_same_however_many_rows_are_converted_together(
    tmp_path: Path, text: str, monkeypatch: pytest.MonkeyPatch
):
    one = table(tmp_path, text)
    monkeypatch.setattr(csv_table, "BLOCK_ROWS", 1)
    other = table(tmp_path, text)
    assert (one.head, one.comments, one.wrong) == (other.head, other.comments, other.wrong)
    np.testing.assert_array_equal(one.values, other.values)
    assert one.lines.tolist() == other.lines.tolist()


def test_random_numbers_come_back_to_the_last_bit(tmp_path: Path):
    rng = random.Random(7)
    rows = [
        [k, rng.gauss(0, 1), rng.uniform(-1, 1) * 10 ** rng.randint(-300, 90)]
        for k in range(2 * csv_table.BLOCK_ROWS + 500)
    ]
    text = "t_s,a,b\n" + "".join(",".join(map(repr, row)) + "\n" for row in rows)
    assert table(tmp_path, text).values.tolist() == rows


@pytest.mark.parametrize("cell", ["1e308", "-1e101", "nan", "inf", "9" * 400])
def test_a_number_that_no_quantity_has_is_none(tmp_path: Path, cell: str):
    wrong = table(tmp_path, f"t_s,F_N\n0,1\n1,{cell}\n2,3\n").wrong_fields("F_N")
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
    with pytest.raises(LogError, match=said):
        read_table(tmp_path / "a.csv")


@pytest.mark.slow
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
    # two seconds for 200,000 rows on an idle machine; tracing memory takes its time, too
    assert time.process_time() - began < 30.0 * rows / 200_000 + 2.0


def test_columns_of_words_and_of_nothing_are_told_apart(tmp_path: Path):
    found = table(tmp_path, "# a\nt_s,F_N,state,seen\n0,1,up,\n1,2,down,\n")
    assert [found.is_words(name) for name in found.head] == [False, False, True, False]
    assert found.lines.tolist() == [3, 4]
