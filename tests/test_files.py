"""Files: what is read is regular, bounded and what it should be; what is written is there whole or not at all."""

import json
import math
import os
import resource
import tempfile
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.errors import InputRefused, NotWritten, plain
from twin.files import LIMIT, json_of, read_bytes, read_text, read_toml, toml_of
from twin.writing import growing, json_text, made_folder, write_text, written


def refusal(path: Path) -> str:
    with pytest.raises(InputRefused) as refused:
        read_toml(path)
    assert len(str(refused.value).splitlines()) == 1
    return str(refused.value)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"\xef\xbb\xbfa = 1", "byte order mark"),
        ("a = 1".encode("utf-16"), "UTF-16"),
        (b"\x89PNG\r\n\x1a\n", "PNG picture"),
        (b"\x89MCAP0\r\n", "MCAP recording"),
        (b"PK\x03\x04", "ZIP archive"),
        (b"a = '\xff'", "not text in UTF-8: byte 5 is 0xff"),
        (b"a = " + b"[" * 9000, "nested too deeply"),
        (b"a = " + b"9" * 5000, "not valid TOML"),
        (b"a = " + b"[" * 40 + b"]" * 40, "nested too deeply"),
        (b"a.b" + b".c" * 40 + b" = 1", "a key of more than 32 parts"),
        (b"a = 0x1ffffffffffffffff", "a whole number of more than 64 bits"),
    ],
)
def test_a_file_of_another_kind_is_told_for_what_it_is(tmp_path: Path, content: bytes, told: str) -> None:
    (tmp_path / "x.toml").write_bytes(content)
    assert told in refusal(tmp_path / "x.toml")


def test_pipes_devices_folders_and_giants_are_refused_at_once(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert "pipe" in refusal(tmp_path / "pipe")
    assert "device" in refusal(Path("/dev/zero"))
    assert "a folder" in refusal(tmp_path)
    assert "no such file" in refusal(tmp_path / "nothing")
    assert "no name of a file" in refusal(Path("a\0b"))
    assert "cannot be read" in refusal(tmp_path / ("n" * 300))
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    assert "cannot be read" in refusal(tmp_path / "loop")
    with (tmp_path / "giant").open("wb") as giant:
        giant.truncate(LIMIT + 1)
    assert "more than 2 MB" in refusal(tmp_path / "giant")
    assert len(read_bytes(tmp_path / "giant", LIMIT + 1)) == LIMIT + 1


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
    with pytest.raises(NotWritten, match="No space"), written(path) as beside:
        beside.write_text("half")
        raise OSError(28, "No space left on device")
    assert path.read_text() == "good"
    assert [file.name for file in tmp_path.iterdir()] == ["page.html"]
    with pytest.raises(NotWritten, match="cannot be written"):
        write_text(tmp_path / "nowhere" / "x", "")


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
        made_folder(Path("/sys/results"))


def test_lines_stay_as_they_were_appended(tmp_path: Path) -> None:
    with growing(tmp_path / "rows") as append:
        for line in ("one\n", "two\n"):
            append(line)
            assert (tmp_path / "rows").read_text().endswith(line)
    with pytest.raises(NotWritten, match="cannot be written"), growing(tmp_path / "no" / "rows"):
        pass
    with pytest.raises(NotWritten, match="No space"), growing(Path("/dev/full")) as append:
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
            made_folder(folder)
    assert made_folder(tmp_path / "a" / "b").is_dir()


@given(st.text(max_size=300))
def test_any_text_is_a_table_or_a_refusal(text: str) -> None:
    for parse in (toml_of, json_of):
        try:
            parse(text, "here")
        except InputRefused as refused:
            assert str(refused).startswith("here: not valid")


def test_as_deep_and_as_large_as_any_file_of_ours_is_read() -> None:
    deep = "[" * 30 + "]" * 30
    found = toml_of(f"a = {deep}\nb = -9223372036854775808\nc.d.e.f = 'a.b.c'", "here")
    assert found["c"] == {"d": {"e": {"f": "a.b.c"}}}
    assert json_of(deep, "here") == toml_of(f"a = {deep}", "here")["a"]


def test_a_file_is_named_as_what_was_expected(tmp_path: Path) -> None:
    for path, said in ((tmp_path / "no", "no such sweep file"), (tmp_path, "a folder; expected a sweep file")):
        with pytest.raises(InputRefused, match=said):
            read_toml(path, "sweep file")


def test_a_sentence_with_hundreds_of_lines_keeps_the_first(tmp_path: Path) -> None:
    told = plain("\n".join(map(str, range(1000)))).splitlines()
    assert told[:2] == ["0", "1"] and len(told) == 61 and told[-1] == "... and 940 more lines"


def test_a_sentence_for_the_terminal_has_no_control_characters_and_no_endless_words() -> None:
    assert plain("a\x1b[31mb\0c\nd") == "a\\x1b[31mb\\x00c\nd"
    assert len(plain("x" * 100_000)) < 100
    assert plain("ordinary: µ, °, 'quoted'") == "ordinary: µ, °, 'quoted'"
