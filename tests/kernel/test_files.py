"""What is read is a regular file, bounded, and what it should be."""

import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.kernel.errors import InputRefused
from twin.kernel.files import MAX_TEXT_BYTES, parse_json, parse_toml, parse_xml, read_bytes, read_toml


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
        *(
            (text.encode(), "a key of more than 32 parts")
            for text in (
                " . ".join("a" * 40) + " = 1",
                "[" + "\t.\t".join("a" * 40) + "]",
                "x = {" + ".".join(["'a'"] * 40) + " = 1}",
                " . ".join(['"a.b"'] * 40) + " = 1",
                '# """\n' + " . ".join("a" * 40) + ' = 1\n# """',
                's = "\\"#"\n' + " . ".join("a" * 40) + " = 1",
            )
        ),
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
    assert "null byte" in refusal(Path("a\0b"))
    assert "cannot be read" in refusal(tmp_path / ("n" * 300))
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    assert "cannot be read" in refusal(tmp_path / "loop")
    with (tmp_path / "giant").open("wb") as giant:
        giant.truncate(MAX_TEXT_BYTES + 1)
    assert "more than 2 MB" in refusal(tmp_path / "giant")
    assert len(read_bytes(tmp_path / "giant", MAX_TEXT_BYTES + 1)) == MAX_TEXT_BYTES + 1


def test_prose_in_comments_and_strings_is_no_key() -> None:
    prose = "One. Two. " * 100
    assert parse_toml(f'# {prose}\na = """{prose}"""\nb = \'{prose}\'', "x")["b"] == prose


@given(st.text(max_size=300))
def test_any_text_is_a_table_or_a_refusal(text: str) -> None:
    for parse in (parse_toml, parse_json):
        try:
            parse(text, "here")
        except InputRefused as refused:
            assert str(refused).startswith("here: not valid")


def test_as_deep_and_as_large_as_any_file_of_ours_is_read() -> None:
    deep = "[" * 30 + "]" * 30
    found = parse_toml(f"a = {deep}\nb = -9223372036854775808\nc.d.e.f = 'a.b.c'", "here")
    assert found["c"] == {"d": {"e": {"f": "a.b.c"}}}
    assert parse_json(deep, "here") == parse_toml(f"a = {deep}", "here")["a"]


def test_a_file_is_named_as_what_was_expected(tmp_path: Path) -> None:
    for path, said in ((tmp_path / "no", "no such sweep file"), (tmp_path, "a folder; expected a sweep file")):
        with pytest.raises(InputRefused, match=said):
            read_toml(path, "sweep file")


def test_a_misspelt_path_leads_to_the_file_beside_it_of_the_same_kind(tmp_path: Path) -> None:
    for name in ("pressing.toml", "presing.txt", "rolling.toml"):
        (tmp_path / name).touch()
    assert refusal(tmp_path / "presing.toml").endswith(f"no such file; did you mean '{tmp_path / 'pressing.toml'}'?")
    # the ending that all have in common makes no two names alike
    assert refusal(tmp_path / "sweep.toml").endswith("no such file")
    assert refusal(tmp_path / "nowhere" / "pressing.toml").endswith("no such file")


@pytest.mark.parametrize(
    ("content", "told"),
    [
        (b"", "no element found"),
        (b"<a>", "no element found"),
        (b"\x00", "not valid XML"),
        (b'<?xml version="1.0" encoding="nonsense"?><a/>', "unknown encoding"),
        (b"<a>&x;</a>", "undefined entity"),
        (b'<!DOCTYPE a SYSTEM "file:///etc/passwd"><a/>', "DOCTYPE"),
        (b'<!DOCTYPE a [<!ENTITY x "xx"><!ENTITY y "&x;&x;">]><a>&y;</a>', "DOCTYPE"),
        (b"<a>" * 40 + b"</a>" * 40, "nested too deeply"),
        (b"<a>" * 1_000_000, "nested too deeply"),
    ],
)
def test_xml_that_grows_names_files_or_is_none_is_refused(content: bytes, told: str) -> None:
    with pytest.raises(InputRefused, match="here: not valid XML") as refused:
        parse_xml(content, "here")
    assert told in str(refused.value)


def test_xml_as_deep_as_ours_is_read() -> None:
    assert parse_xml(b"<a>" * 30 + b"<b c='1'/>" + b"</a>" * 30, "here").find(".//b").attrib == {"c": "1"}  # type: ignore[union-attr]
