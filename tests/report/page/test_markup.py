from html.parser import HTMLParser
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from twin.report.page.markup import DARK_MATRIX, DataBlock, element, join_markup, table, thin_samples, thinning_factor
from twin.studies import figure
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
    assert join_markup(["a & b", element("i")]) == "a &amp; b<i></i>"


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
    few = thin_samples(values, factor)
    assert len(few) == 2 * -(-len(values) // (2 * factor))
    for bucket, pair in enumerate(few.reshape(-1, 2)):
        own = values[2 * factor * bucket : 2 * factor * (bucket + 1)]
        assert pair.min() == own.min() and pair.max() == own.max()


def test_few_samples_are_not_thinned():
    values = np.arange(10.0)
    assert thin_samples(values, thinning_factor(10, 10)) is values
    assert thinning_factor(11, 10) == 2


OKABE_ITO = (figure.BLUE, figure.ORANGE, figure.GREEN, figure.PINK, figure.VERMILION, figure.SKY)
TOGETHER = (
    (*OKABE_ITO, figure.INK, figure.GREY),
    (figure.PAPER_BLUE, figure.PAPER_YELLOW, figure.PAPER_ORANGE, figure.INK, figure.GREY),
    (*figure.JOINT_COLORS, figure.RED, figure.GREY),
)
"""Colours that lie beside each other in one picture."""
FAR = 70.0
"""Distance in CIELAB from which on nobody confuses two lines: beyond it there is room to lose."""
D65 = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])


def rgb(colour: str) -> NDArray[np.float64]:
    return np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])


def dark(colour: str) -> NDArray[np.float64]:
    matrix = np.array(DARK_MATRIX)
    return np.clip(matrix[:, :3] @ rgb(colour) + matrix[:, 3], 0.0, 1.0)


def xyz(colour: NDArray[np.float64]) -> NDArray[np.float64]:
    return D65 @ np.where(colour <= 0.04045, colour / 12.92, ((colour + 0.055) / 1.055) ** 2.4)


def contrast(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    darker, lighter = sorted((xyz(a)[1], xyz(b)[1]))
    return float((lighter + 0.05) / (darker + 0.05))


def lab(colour: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z = xyz(colour) / D65.sum(axis=1)
    f = [np.cbrt(v) if v > 0.008856 else 7.787 * v + 16 / 116 for v in (x, y, z)]
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def test_the_ground_is_dark_and_letters_are_read_on_it():
    assert dark("#ffffff").max() < 0.15
    # 7: what WCAG 2.1 asks of text at its highest level
    assert contrast(dark(figure.INK), dark("#ffffff")) > 7.0


@pytest.mark.parametrize("colour", sorted({colour for group in TOGETHER for colour in group}))
def test_every_line_stands_out_from_the_dark_ground(colour: str):
    # 3: what WCAG 2.1 asks of graphics
    assert contrast(dark(colour), dark("#ffffff")) > 3.0


@pytest.mark.parametrize("group", TOGETHER)
def test_lines_of_one_picture_are_as_far_apart_as_on_white(group: tuple[str, ...]):
    for a, b in combinations(group, 2):
        before, after = (float(np.linalg.norm(lab(seen(a)) - lab(seen(b)))) for seen in (rgb, dark))
        # three quarters: one map for all colours cannot keep each of 40 distances
        assert after > 0.7 * min(before, FAR), (a, b, before, after)


@pytest.mark.parametrize("colour", [figure.BLUE, figure.ORANGE, figure.GREEN, figure.VERMILION, *TOGETHER[1][:3]])
def test_a_colour_keeps_its_name(colour: str):
    hue_before, hue_after = (np.degrees(np.arctan2(*lab(c)[:0:-1])) for c in (rgb(colour), dark(colour)))
    # 30 degrees of hue are half the way from one basic colour to the next
    assert abs((hue_after - hue_before + 180.0) % 360.0 - 180.0) < 30.0
