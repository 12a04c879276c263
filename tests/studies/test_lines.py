"""Text for people in lines of at most 80 columns."""

from hypothesis import given
from hypothesis import strategies as st

from twin.studies.result import WIDTH, counted, labelled, markdown, wrapped

words = st.lists(st.text("ab-", min_size=1, max_size=20), min_size=1, max_size=40).map(" ".join)


@given(words, st.booleans())
def test_no_line_is_wider_than_80_columns_and_no_word_is_lost(text: str, whole: bool):
    lines = wrapped(text, "  head  ", 3, whole)
    assert max(map(len, lines)) <= WIDTH
    assert lines[0].startswith("  head  ") and all(line.startswith("   ") and line[3] != " " for line in lines[1:])
    joined = "".join([lines[0][8:], *(line[3:] for line in lines[1:])])
    assert joined.replace(" ", "") == text.replace(" ", "")


def test_names_stay_whole_where_they_are_to():
    path = "results/" + "-".join(["long"] * 20)
    assert wrapped(f"see {path}", whole=True) == ["see", path]
    assert len(wrapped(f"see {path}")) == 2 and wrapped(f"see {path}")[0].endswith("long-")


def test_later_lines_begin_below_the_text_of_a_label():
    first, second = labelled("note", "x" * 60 + " y" * 10)
    assert first.startswith("  note       x") and second.startswith(" " * 13 + "y")


def test_a_markdown_table_has_a_rule_below_its_head():
    assert markdown(("a", "b"), [("1", "2")]) == "| a | b |\n|---|---|\n| 1 | 2 |"


def test_one_of_something_has_no_s():
    assert [counted(n, "run") for n in (0, 1, 2)] == ["0 runs", "1 run", "2 runs"]
