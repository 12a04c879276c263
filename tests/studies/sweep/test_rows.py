"""Rows survive a crash at any byte, a full disk, and are never mixed up or counted twice."""

import json
from pathlib import Path

import pytest

from tests.recording.test_output import largest_file
from tests.studies.sweep.statistics import rows as made_up
from twin.errors import InputRefused
from twin.studies.sweep.rows import DiskFailed, Rows, read_columns, read_rows


def row(number: int) -> dict:
    return {**made_up.row(number, {}, peak_N=0.1 * number, end_N=None), "key": f"k{number}", "reason": "ü\n"}


@pytest.fixture
def file(tmp_path: Path) -> Path:
    with Rows(tmp_path / "rows.jsonl") as rows:
        rows.add([row(1), row(2)])
        rows.add([row(3)])
    return tmp_path / "rows.jsonl"


def test_what_is_added_is_read_again(file: Path):
    assert read_rows(file) == [row(1), row(2), row(3)]
    columns, end = read_columns(file)
    assert columns.numbers("run").tolist() == [1, 2, 3] and end == file.stat().st_size


def test_a_line_torn_at_any_byte_is_dropped_and_its_run_can_be_added_again(file: Path):
    whole = file.read_bytes()
    begins = whole[:-1].rindex(b"\n") + 1
    for end in range(begins, len(whole)):
        file.write_bytes(whole[:end])
        with Rows(file) as rows:
            assert list(rows.before.words("key")) == ["k1", "k2"] and rows.count == 2
            rows.add([row(3)])
        assert file.read_bytes() == whole


def test_a_row_that_is_there_twice_counts_once(file: Path):
    content = file.read_bytes()
    file.write_bytes(content + content.replace(b'"done"', b'"tripped"'))
    assert read_rows(file) == [row(1), row(2), row(3)]
    columns, end = read_columns(file)
    assert list(columns.words("key")) == ["k1", "k2", "k3"] and columns.words("status").counts == {"done": 3}
    # its bytes are not cut off
    assert end == file.stat().st_size


def test_a_line_that_is_no_row_is_refused_with_its_number(file: Path):
    lines = file.read_bytes().splitlines(keepends=True)
    for damaged in (b"\0\0\0\n", b"{}\n", b"[1]\n", b'"key"\n'):
        file.write_bytes(lines[0] + damaged + lines[2])
        with pytest.raises(InputRefused, match="line 2 is no row of a sweep"):
            Rows(file)


def test_what_json_of_python_alone_can_read_and_what_another_version_wrote_more_is_a_row(file: Path):
    # half of a pair of code units: of a file's name that is no text in UTF-8
    odd = {**row(4), "reason": "no such file: \udce4", "of_another_version": {"a": 1}}
    with Rows(file) as rows:
        rows.add([odd])
    assert read_rows(file)[-1] == odd
    assert read_columns(file)[0].words("reason")[3] == odd["reason"]


@pytest.mark.parametrize("spare", [0, 1, 150])
def test_a_full_disk_keeps_every_row_before_and_room_lets_it_go_on(file: Path, spare: int):
    before = file.read_bytes()
    with Rows(file) as rows:
        with largest_file(len(before) + spare), pytest.raises(DiskFailed, match="3 finished runs are kept"):
            rows.add([row(4), row(5)])
        assert file.read_bytes() == before
        rows.add([row(4)])
    assert read_rows(file) == [row(number) for number in range(1, 5)]


def test_two_sweeps_never_write_to_the_same_file(file: Path):
    with Rows(file), pytest.raises(InputRefused, match="another twin sweep is writing there"):
        Rows(file)


def test_a_number_that_json_does_not_have_is_never_written(file: Path):
    before = file.read_bytes()
    with Rows(file) as rows, pytest.raises(ValueError, match="JSON"):
        rows.add([{"key": "k9", "metrics": {"peak_N": float("nan")}}])
    assert file.read_bytes() == before
    assert all(json.loads(line) for line in before.splitlines())
