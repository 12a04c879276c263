"""One renderer: what stands in tables, notes and files is the same as text and for programs.

Text for people in lines of at most 80 columns.
"""

import subprocess
import sys
from math import inf, nan

import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.studies.command import answer_study
from twin.studies.result import (
    NO_BREAK_SPACE,
    TEXT_WIDTH,
    WIDTH_VARIABLE,
    Column,
    Note,
    Result,
    Table,
    count_text,
    labelled_lines,
    lay_out,
    markdown,
    note,
    render_text,
    to_json,
    wrap_text,
)

COLUMNS = (Column("joint", left=True), Column("error", 8, "+.2f", "mm"), Column("why", left=True, gap=3, folds=True))
TABLE = Table(COLUMNS, [("first", -0.001, "a reason"), ("second one", 12.345, ""), ("third",)])
RESULT = Result("all is well", ["", TABLE, note("note", "a sentence")], files={"picture": "a.png"})


def test_columns_stand_below_each_other_with_their_units_and_digits():
    assert lay_out([TABLE]).splitlines() == [
        "  joint         error   why",
        "                   mm",
        "  first         +0.00   a reason",
        "  second one   +12.35",
        "  third",
    ]


@pytest.mark.parametrize(
    ("value", "form", "shown"),
    [
        (-0.0004, ".3f", "0.000"), (-0.0006, ".3f", "-0.001"), (nan, ".3f", "-"), (inf, ".3f", "inf"), (None, "", ""),
        (3, "", "3"), (0, "d", "0"), ("-0.0", ".3f", "-0.0"), ("a long name", ".6s", "a long"), (None, ".6s", ""),
    ],
)  # fmt: skip
def test_a_cell_is_shown_in_the_format_of_its_column(value: float | str | None, form: str, shown: str):
    assert Column(form=form).text(value) == shown


def test_a_cell_beyond_its_width_moves_what_follows_on_its_own_line_only():
    rows = [("ab", "x"), ("a" * 9, "x")]
    assert lay_out([Table((Column("", 4, left=True), Column()), rows)]) == "  ab   x\n  aaaaaaaaa x"


words = st.lists(st.text("ab-", min_size=1, max_size=12), max_size=40).map(" ".join)


@given(st.lists(st.tuples(st.text("xyz", max_size=8), words), min_size=1), words)
def test_the_last_column_and_notes_are_folded_into_80_columns(rows: list[tuple[str, str]], text: str):
    table = Table((Column("name", 8, left=True), Column("meaning", left=True, folds=True)), rows)
    lines = lay_out([table, Note(text, "  note  ")]).splitlines()
    assert max(map(len, lines)) <= TEXT_WIDTH
    assert not any(line.endswith(" ") for line in lines)


def test_columns_that_do_not_fit_are_left_out_and_said_to_be():
    table = Table([Column(f"{i}" * 30) for i in range(4)], [["a"] * 4], left_out="--html")
    head, row, said = lay_out([table]).splitlines()
    assert head == f"  {'0' * 30} {'1' * 30}" and len(row) == len(head)
    assert said == "  (2 more columns in --html)"


def test_a_line_may_stand_between_rows_and_a_sentence_below_one():
    table = Table((Column(left=True), Column("", 3)), ["drive", ("a", 1), Note("x " * 40, "    ")])
    assert lay_out([table]).splitlines()[:2] == ["drive", "  a   1"]
    assert len(lay_out([table]).splitlines()) == 4


def test_what_is_tied_stays_on_one_line():
    apart, tied = (lay_out([Note(f"{'a' * 76} 12{space}N")]).splitlines() for space in (" ", NO_BREAK_SPACE))
    assert apart[0].endswith("a 12") and tied[1] == "12 N"


def test_the_text_ends_with_the_files_and_an_empty_line_stays():
    first, empty, *_, said, file = render_text(RESULT).splitlines()
    assert (first, empty) == ("all is well", "")
    assert (said, file) == ("  note       a sentence", "  picture    a.png")
    assert render_text(Result("x", files={"a": "b"}, label=0)) == "x\n  b"


def test_programs_get_the_facts_or_what_people_read_with_its_numbers():
    assert to_json(Result("x", facts={"a": 1})) == {"a": 1}
    found = to_json(RESULT)
    assert found["headline"] == "all is well" and found["files"] == {"picture": "a.png"}
    assert found["notes"] == ["note: a sentence"]
    (table,) = found["tables"]
    assert table["columns"][1] == {"name": "error", "unit": "mm"}
    assert table["rows"][1] == ["second one", 12.345, ""]


class Listener:
    def note(self, **values: object) -> None:
        """Nobody listens."""


def failing(say: object) -> Result:
    return Result("it fails", [TABLE], exit_code=1)


def test_who_asks_a_study_gets_its_text_facts_and_exit_code():
    answer = answer_study(Listener(), f"{__name__}:failing", {})  # type: ignore[arg-type]
    assert answer == {"text": failing(None).text, "facts": to_json(failing(None)), "exit_code": 1}


@pytest.mark.slow
def test_what_says_text_only_loads_no_matplotlib():
    # `compare --paper` is not among them: it always draws the figure
    names = (
        "check.text", "compare.text", "converge.text", "falsify.text", "identify.text", "qualify.text",
    )  # fmt: skip
    code = f"import sys, {', '.join(f'twin.studies.{name}' for name in names)}; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


sentences = st.lists(st.text("ab-", min_size=1, max_size=20), min_size=1, max_size=40).map(" ".join)


@given(sentences, st.booleans())
def test_no_line_is_wider_than_80_columns_and_no_word_is_lost(text: str, whole: bool):
    lines = wrap_text(text, "  head  ", 3, whole)
    assert max(map(len, lines)) <= TEXT_WIDTH
    assert lines[0].startswith("  head  ") and all(line.startswith("   ") and line[3] != " " for line in lines[1:])
    joined = "".join([lines[0][8:], *(line[3:] for line in lines[1:])])
    assert joined.replace(" ", "") == text.replace(" ", "")


@pytest.mark.parametrize(("width", "longest"), [("60", 60), ("20", 40), ("500", 120), ("", 80), ("wide", 80)])
def test_a_text_is_as_wide_as_the_terminal(monkeypatch: pytest.MonkeyPatch, width: str, longest: int):
    monkeypatch.setenv(WIDTH_VARIABLE, width)
    lines = wrap_text("a " * 500)
    assert {len(line) for line in lines[:-1]} == {longest - 1}


def test_names_stay_whole_where_they_are_to():
    path = "results/" + "-".join(["long"] * 20)
    assert wrap_text(f"see {path}", whole=True) == ["see", path]
    assert len(wrap_text(f"see {path}")) == 2 and wrap_text(f"see {path}")[0].endswith("long-")


def test_later_lines_begin_below_the_text_of_a_label():
    first, second = labelled_lines("note", "x" * 60 + " y" * 10)
    assert first.startswith("  note       x") and second.startswith(" " * 13 + "y")


def test_a_markdown_table_has_a_rule_below_its_head():
    assert markdown(("a", "b"), [("1", "2")]) == "| a | b |\n|---|---|\n| 1 | 2 |"


def test_one_of_something_has_no_s():
    assert [count_text(n, "run") for n in (0, 1, 2)] == ["0 runs", "1 run", "2 runs"]
