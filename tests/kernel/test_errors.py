"""Sentences for the terminal."""

import errno
import os
from pathlib import Path

import pytest

from twin.kernel.errors import PATH_ERRORS, InputRefused, NotWritten, nearest, terminal_text, translate_disk_errors


def test_a_sentence_with_hundreds_of_lines_keeps_the_first(tmp_path: Path) -> None:
    told = terminal_text("\n".join(map(str, range(1000)))).splitlines()
    assert told[:2] == ["0", "1"] and len(told) == 61 and told[-1] == "... and 940 more lines"


def test_a_sentence_for_the_terminal_has_no_control_characters_and_no_endless_words() -> None:
    assert terminal_text("a\x1b[31mb\0c\nd") == "a\\x1b[31mb\\x00c\nd"
    assert len(terminal_text("x" * 100_000)) < 100
    assert terminal_text("ordinary: µ, °, 'quoted'") == "ordinary: µ, °, 'quoted'"


def test_a_misspelt_name_leads_to_the_nearest():
    assert nearest("sead", ["duration_s", "seed"]) == "did you mean 'seed'?"
    assert nearest("plant.p_b", ["plant.p_B", "plant.F", "x"], most=3) == "did you mean 'plant.p_B' or 'plant.F'?"


def test_a_name_of_whole_words_goes_before_one_that_is_merely_like_it():
    assert nearest("kp", ["kpp", "kp_per_s"]) == "did you mean 'kp_per_s'?"
    assert nearest("F_z", ["plant.F_ee", "controller.F_z_ref"]) == "did you mean 'controller.F_z_ref'?"
    assert nearest("p", ["kp_per_s"]) == "known are kp_per_s"


def test_where_nothing_is_like_it_all_names_are_told():
    assert nearest("xyz", ["a", "b{}"]) == "known are a, b{}"
    assert nearest("", [], "it has {}") == "it has none"
    assert nearest("a+", ["(b"], "expected a file") == "expected a file"


def test_what_the_disk_refuses_is_a_sentence_with_the_remedy():
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with (
        pytest.raises(NotWritten, match=r"^a\.csv: cannot be written: No space left on device$"),
        translate_disk_errors("a.csv"),
    ):
        raise full
    refusals = translate_disk_errors("b", "cannot be read", InputRefused, "rename it", PATH_ERRORS)
    with pytest.raises(InputRefused, match=r"^b: cannot be read: embedded null byte; rename it$"), refusals:
        os.stat("a\0b")


def test_a_mistake_of_ours_is_nothing_that_the_disk_refuses():
    with pytest.raises(ValueError, match="ours"), translate_disk_errors("a"):
        raise ValueError("ours")
