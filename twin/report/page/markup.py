"""Escaped HTML: no user text is taken for markup.

All samples of a run as one text that a browser turns back into numbers fast.
"""

import math
from collections.abc import Iterable, Sequence
from html import escape

import numpy as np
from numpy.typing import NDArray

from twin.studies.metrics.response import Curve
from twin.studies.packing import text_of

DARK_MATRIX = (
    (0.60, -1.15, -0.36, 1.01),
    (-0.57, 0.15, -0.49, 1.03),
    (-0.52, -0.84, 0.46, 1.03),
)
"""Weights of red, green and blue (0 .. 1, sRGB) and a constant, a row for each of the new ones, which are then clipped.

Light turned dark with every hue kept would make mud of yellow and orange, which are as light as the ground they lie on.
These were fitted to the colours of `twin.studies.figure` (Powell's method, distances in CIELAB): white becomes the
page's ground, ink light, and every colour a lighter one of its own name, as far from the others as it was."""


class Markup(str):
    """HTML as it stands in the page; any other text is escaped where it is put into an element."""

    __slots__ = ()


def element(tag: str, *children: str, **attributes: str) -> Markup:
    """`<tag attribute="...">children</tag>`; of an attribute's name `class_` gives class and `data_t` data-t."""
    named = "".join(f' {key.strip("_").replace("_", "-")}="{escape(value)}"' for key, value in attributes.items())
    return Markup(f"<{tag}{named}>{join_markup(children)}</{tag}>")


def join_markup(children: Iterable[str]) -> Markup:
    """Children one after the other, those that are no markup escaped."""
    return Markup("".join(child if isinstance(child, Markup) else escape(child) for child in children))


def table(head: Sequence[str], rows: Iterable[Sequence[str]], label: str) -> Markup:
    """A table that scrolls in its own box where the screen is too narrow for it; the first cell heads its row.

    Args:
        head: titles of the columns.
        rows: cells, as many in each.
        label: what it shows, for who does not see it.
    """
    titles = element("tr", *(element("th", title, scope="col") for title in head))
    lines = [
        element("tr", element("th", row[0], scope="row"), *(element("td", cell) for cell in row[1:])) for row in rows
    ]
    inside = element("table", element("thead", titles), element("tbody", *lines))
    return element("div", inside, class_="scroll", tabindex="0", role="region", aria_label=label)


def section(key: str, title: str, *children: str) -> Markup:
    """A section of the page with its heading."""
    heading = element("h2", title, id=f"{key}-title")
    return element("section", heading, *children, id=key, aria_labelledby=f"{key}-title")


class DataBlock:
    """The samples of one run, in the order in which they were added."""

    def __init__(self) -> None:
        self._parts: list[NDArray[np.float32]] = []
        self._length = 0

    def add(self, values: Curve) -> list[int]:
        """[where they begin, how many there are] of `values`, of any shape, row by row."""
        part = np.ravel(values).astype("<f4")
        place = [self._length, part.size]
        self._parts.append(part)
        self._length += part.size
        return place

    def content(self) -> bytes:
        """Everything added, 32 bit floats, little-endian."""
        return b"".join(part.tobytes() for part in self._parts)

    def text(self) -> str:
        """Everything added, as `twin.studies.packing` writes it."""
        return text_of(np.concatenate([np.empty(0, "<f4"), *self._parts]))


def thin_samples(values: Curve, factor: int) -> Curve:
    """Every `factor`-th part as many samples (n,) in which every peak remains: the extremes of every 2 `factor`.

    Of each pair the one that comes first stands first. Sample j lies within 2 `factor` samples of j times `factor`.
    """
    if factor == 1:
        return values
    width = 2 * factor
    padded = np.pad(values, (0, -len(values) % width), mode="edge").reshape(-1, width)
    pair = np.sort(np.column_stack([padded.argmin(axis=1), padded.argmax(axis=1)]), axis=1)
    return np.take_along_axis(padded, pair, axis=1).ravel()


def thinning_factor(samples: int, most: int) -> int:
    """The factor by which `samples` have to be thinned so that about `most` are left."""
    return max(1, math.ceil(samples / most))


def dark_filter() -> Markup:
    """The SVG filter `#dark` that the style sheet applies to pictures."""
    rows = (f"{r:g} {g:g} {b:g} 0 {constant:g}" for r, g, b, constant in DARK_MATRIX)
    matrix = f'<feColorMatrix values="{" ".join(rows)} 0 0 0 1 0"/>'
    kind = 'id="dark" color-interpolation-filters="sRGB"'
    return Markup(f'<svg width="0" height="0" aria-hidden="true"><filter {kind}>{matrix}</filter></svg>')
