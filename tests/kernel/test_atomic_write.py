"""What is written is there whole or not at all."""

import json
import math
import os
import resource
import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.kernel.atomic_write import atomic_write, json_text, make_folder, open_unbuffered, write_text
from twin.kernel.errors import InputRefused, NotWritten
from twin.kernel.files import read_text


@given(st.text())
def test_what_is_written_is_what_is_read(text: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "text"
        write_text(path, "x" + text)
        assert read_text(path) == "x" + text
        assert [file.name for file in Path(folder).iterdir()] == ["text"]


def test_a_write_that_fails_leaves_what_was_there(tmp_path: Path) -> None:
    path = tmp_path / "page.html"
    write_text(path, "good")
    with pytest.raises(NotWritten, match="No space"), atomic_write(path) as beside:
        beside.write_text("half")
        raise OSError(28, "No space left on device")
    assert path.read_text() == "good"
    assert [file.name for file in tmp_path.iterdir()] == ["page.html"]
    with pytest.raises(NotWritten, match="cannot be written"):
        write_text(path / "x", "")
    # folders that are missing are made
    write_text(tmp_path / "new" / "er" / "x", "")
    assert (tmp_path / "new" / "er" / "x").read_text() == ""


def test_a_device_or_a_folder_is_never_replaced_by_a_file(tmp_path: Path) -> None:
    before = os.stat("/dev/null").st_rdev
    for path in (Path("/dev/null"), tmp_path):
        with pytest.raises(InputRefused, match="expected the name of a file"):
            write_text(path, "x")
    assert os.stat("/dev/null").st_rdev == before != 0
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(InputRefused, match="a pipe or device"):
        write_text(tmp_path / "pipe", "x")


def test_a_link_stays_and_what_it_points_to_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "there" / "file")
    write_text(tmp_path / "link", "one")
    write_text(tmp_path / "link", "two")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "there" / "file").read_text() == "two"
    assert [file.name for file in (tmp_path / "there").iterdir()] == ["file"]


@pytest.mark.parametrize("size", [0, 100, 5000])
def test_a_disk_that_fills_up_on_the_way_leaves_what_was_there(tmp_path: Path, size: int) -> None:
    path = tmp_path / "page.html"
    write_text(path, "good")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        with pytest.raises(NotWritten, match=r"page.html: cannot be written: File too large"):
            write_text(path, "x" * 10_000)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.read_text() == "good"
    assert [file.name for file in tmp_path.iterdir()] == ["page.html"]


def test_where_even_root_may_not_write_is_a_sentence() -> None:
    with pytest.raises(NotWritten, match=r"^/sys/page.html: cannot be written: "):
        write_text(Path("/sys/page.html"), "x")
    with pytest.raises(InputRefused, match=r"^/sys/results: cannot be created: "):
        make_folder(Path("/sys/results"))


def test_lines_stay_as_they_were_appended(tmp_path: Path) -> None:
    with open_unbuffered(tmp_path / "rows") as append:
        for line in ("one\n", "two\n"):
            append(line)
            assert (tmp_path / "rows").read_text().endswith(line)
    with pytest.raises(NotWritten, match="cannot be written"), open_unbuffered(tmp_path / "no" / "rows"):
        pass
    with pytest.raises(NotWritten, match="No space"), open_unbuffered(Path("/dev/full")) as append:
        append("one")


@given(st.recursive(st.none() | st.booleans() | st.floats() | st.text(), lambda inner: st.lists(inner)
                    | st.dictionaries(st.text(), inner)))  # fmt: skip
def test_json_is_json_whatever_the_numbers(facts: object) -> None:
    def refuse(constant: str) -> None:
        raise AssertionError(constant)

    def told(value: object) -> object:
        if isinstance(value, float):
            return value if math.isfinite(value) else None
        if isinstance(value, list):
            return [told(item) for item in value]
        return {key: told(item) for key, item in value.items()} if isinstance(value, dict) else value

    assert json.loads(json_text(facts), parse_constant=refuse) == told(facts)


def test_what_is_written_is_as_readable_as_any_other_file(tmp_path: Path) -> None:
    (tmp_path / "plain").write_text("")
    write_text(tmp_path / "ours", "")
    assert (tmp_path / "ours").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_a_folder_that_cannot_be_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for folder in (tmp_path / "file", tmp_path / "a\0b", tmp_path / ("n" * 300)):
        with pytest.raises(InputRefused):
            make_folder(folder)
    assert make_folder(tmp_path / "a" / "b").is_dir()
