from html.parser import HTMLParser

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from twin.report.page.markup import DataBlock, element, joined, table, thinned, thinning
from twin.studies.packing import values_of


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


samples = arrays(np.float64, st.integers(1, 200), elements=st.floats(-1e6, 1e6, width=32))


@given(samples, samples)
def test_what_comes_out_of_a_block_is_what_went_in_to_32_bits(a: np.ndarray, b: np.ndarray):
    block = DataBlock()
    places = [block.add(a), block.add(b)]
    whole = values_of(block.text())
    for values, (at, count) in zip((a, b), places, strict=True):
        np.testing.assert_array_equal(whole[at : at + count], values.astype(np.float32))


@given(samples, st.integers(2, 20))
def test_thinning_keeps_every_peak_where_it_was(values: np.ndarray, factor: int):
    few = thinned(values, factor)
    assert len(few) == 2 * -(-len(values) // (2 * factor))
    for bucket, pair in enumerate(few.reshape(-1, 2)):
        own = values[2 * factor * bucket : 2 * factor * (bucket + 1)]
        assert pair.min() == own.min() and pair.max() == own.max()


def test_few_samples_are_not_thinned():
    values = np.arange(10.0)
    assert thinned(values, thinning(10, 10)) is values
    assert thinning(11, 10) == 2
