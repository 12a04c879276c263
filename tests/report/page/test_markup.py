from html.parser import HTMLParser

from hypothesis import given
from hypothesis import strategies as st

from twin.report.page.markup import element, joined, table


class Reader(HTMLParser):
    def __init__(self) -> None:
        super().__init__(convert_charrefs=True)
        self.tags: list[str] = []
        self.text = ""
        self.attributes: dict[str, str | None] = {}

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.attributes |= dict(attrs)

    def handle_data(self, data: str) -> None:
        self.text += data


def read(html: str) -> Reader:
    reader = Reader()
    reader.feed(html)
    reader.close()
    return reader


# a carriage return is a line feed to every HTML reader, a null character is nothing
texts = st.text(st.characters(exclude_characters="\r\0", exclude_categories=["Cs"]))


@given(texts, texts)
def test_a_text_reads_back_as_it_was_and_makes_no_tags(text: str, label: str):
    found = read(element("p", text, title=label))
    assert (found.tags, found.text, found.attributes) == (["p"], text, {"title": label})


def test_markup_is_not_escaped_twice():
    assert element("div", element("b", "<")) == "<div><b>&lt;</b></div>"
    assert joined(["a & b", element("i")]) == "a &amp; b<i></i>"


def test_cells_of_a_table_are_escaped():
    found = read(table(("<a>",), [("<script>alert(1)</script>",)], "label"))
    assert "script" not in found.tags and "<script>" in found.text
