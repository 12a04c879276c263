"""Escaped HTML, so that user text is never parsed as markup, and compact encoding of samples for a browser."""

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
"""Colour matrix of the dark page: weights of red, green and blue (0 .. 1, sRGB) and a constant, a row for each new
component; results are clipped.

Inverting the lightness while keeping each hue would turn yellow and orange, which are as light as the background, into
muddy colours. This matrix was fitted to the colours of `twin.studies.figure` (Powell's method, distances in CIELAB):
white becomes the page's background, ink light, and every colour a lighter one of the same name, with its distance from
the others unchanged."""


class Markup(str):
    """HTML text of a page; any other text is escaped when it is put into an element."""

    __slots__ = ()


def element(tag: str, *children: str, **attributes: str) -> Markup:
    """Return an HTML element `<tag attribute="...">children</tag>`; keyword `class_` gives class, `data_t` data-t."""
    named = "".join(f' {key.strip("_").replace("_", "-")}="{escape(value)}"' for key, value in attributes.items())
    return Markup(f"<{tag}{named}>{join_markup(children)}</{tag}>")


def join_markup(children: Iterable[str]) -> Markup:
    """Concatenate children to HTML, escaping all other text than `Markup`."""
    return Markup("".join(child if isinstance(child, Markup) else escape(child) for child in children))


def table(head: Sequence[str], rows: Iterable[Sequence[str]], label: str) -> Markup:
    """Return an HTML table, scrolled in its own box; rows begin with a heading, `label` is for screen readers."""
    titles = element("tr", *(element("th", title, scope="col") for title in head))
    lines = [
        element("tr", element("th", row[0], scope="row"), *(element("td", cell) for cell in row[1:])) for row in rows
    ]
    inside = element("table", element("thead", titles), element("tbody", *lines))
    return element("div", inside, class_="scroll", tabindex="0", role="region", aria_label=label)


def section(key: str, title: str, *children: str) -> Markup:
    heading = element("h2", title, id=f"{key}-title")
    return element("section", heading, *children, id=key, aria_labelledby=f"{key}-title")


class DataBlock:
    """The samples of one run's curves for a page's scripts, in the order of their addition."""

    def __init__(self) -> None:
        self._parts: list[NDArray[np.float32]] = []
        self._length = 0

    def add(self, values: Curve) -> list[int]:
        """Append `values` of any shape to the samples, row by row; return [index of the first, count]."""
        part = np.ravel(values).astype("<f4")
        place = [self._length, part.size]
        self._parts.append(part)
        self._length += part.size
        return place

    def content(self) -> bytes:
        """Return all samples of the block as 32-bit floats, little-endian."""
        return b"".join(part.tobytes() for part in self._parts)

    def text(self) -> str:
        """Return all samples of the block as text in the encoding of `twin.studies.packing`."""
        return text_of(np.concatenate([np.empty(0, "<f4"), *self._parts]))


def thin_samples(values: Curve, factor: int) -> Curve:
    """Thin the curve `values` (n,) by `factor` without losing peaks: keep the extremes of every 2 `factor` samples.

    Sample j of the result is within 2 `factor` samples of j times `factor`.
    """
    if factor == 1:
        return values
    width = 2 * factor
    padded = np.pad(values, (0, -len(values) % width), mode="edge").reshape(-1, width)
    pair = np.sort(np.column_stack([padded.argmin(axis=1), padded.argmax(axis=1)]), axis=1)
    return np.take_along_axis(padded, pair, axis=1).ravel()


def thinning_factor(samples: int, most: int) -> int:
    """Return the factor that thins a curve of `samples` samples to about `most`."""
    return max(1, math.ceil(samples / most))


def dark_filter() -> Markup:
    """Return the SVG filter `#dark` that the style sheet applies to pictures in dark mode."""
    rows = (f"{r:g} {g:g} {b:g} 0 {constant:g}" for r, g, b, constant in DARK_MATRIX)
    matrix = f'<feColorMatrix values="{" ".join(rows)} 0 0 0 1 0"/>'
    kind = 'id="dark" color-interpolation-filters="sRGB"'
    return Markup(f'<svg width="0" height="0" aria-hidden="true"><filter {kind}>{matrix}</filter></svg>')
