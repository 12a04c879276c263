"""Sentences for the terminal."""

from pathlib import Path

from twin.errors import plain


def test_a_sentence_with_hundreds_of_lines_keeps_the_first(tmp_path: Path) -> None:
    told = plain("\n".join(map(str, range(1000)))).splitlines()
    assert told[:2] == ["0", "1"] and len(told) == 61 and told[-1] == "... and 940 more lines"


def test_a_sentence_for_the_terminal_has_no_control_characters_and_no_endless_words() -> None:
    assert plain("a\x1b[31mb\0c\nd") == "a\\x1b[31mb\\x00c\nd"
    assert len(plain("x" * 100_000)) < 100
    assert plain("ordinary: µ, °, 'quoted'") == "ordinary: µ, °, 'quoted'"
