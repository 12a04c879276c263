"""Pictures, which are drawn on white, on a dark page: one linear map of colours, done by the browser."""

from twin.report.page.markup import Markup

TO_DARK = (
    (0.60, -1.15, -0.36, 1.01),
    (-0.57, 0.15, -0.49, 1.03),
    (-0.52, -0.84, 0.46, 1.03),
)
"""Weights of red, green and blue (0 .. 1, sRGB) and a constant, a row for each of the new ones, which are then clipped.

Light turned dark with every hue kept would make mud of yellow and orange, which are as light as the ground they lie on.
These were fitted to the colours of `twin.studies.figure` (Powell's method, distances in CIELAB): white becomes the
page's ground, ink light, and every colour a lighter one of its own name, as far from the others as it was."""


def dark_filter() -> Markup:
    """The SVG filter `#dark` that the style sheet applies to pictures."""
    rows = (f"{r:g} {g:g} {b:g} 0 {constant:g}" for r, g, b, constant in TO_DARK)
    matrix = f'<feColorMatrix values="{" ".join(rows)} 0 0 0 1 0"/>'
    kind = 'id="dark" color-interpolation-filters="sRGB"'
    return Markup(f'<svg width="0" height="0" aria-hidden="true"><filter {kind}>{matrix}</filter></svg>')
