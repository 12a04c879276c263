"""Style and saving of pictures: PNG for the screen, SVG and PDF for a paper."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.kernel.atomic_write import atomic_write

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure
else:
    # matplotlib loads slowly, and most studies only print text
    Axes = Figure = Any

COLUMN_WIDTHS = {1: 3.5, 2: 7.16}
"""Width (in) of a picture across one and two columns of a paper, as IEEE requires."""
FONT_SIZE = 8.0
"""Font size in a paper (pt)."""
PANEL_HEIGHT = 1.9
"""Height (in) of a panel in one column of stacked panels."""
HEAVY_LINE, FINE_LINE = 1.0, 0.6
"""Line weights (pt) in a paper; a heavy line has more than 1 pt on the screen."""
NO_DATE: Mapping[str, Mapping[str, None]] = {
    "svg": {"Date": None, "Creator": None}, "pdf": {"CreationDate": None, "Producer": None},
}  # fmt: skip
"""Metadata that suppresses a file's date and writer, for reproducible files."""
BLUE, ORANGE, GREEN, PINK, VERMILION, SKY = "#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9"
"""Colours of Okabe and Ito (https://jfly.uni-koeln.de/color), distinguishable for colour-blind readers."""
PAPER_BLUE, PAPER_YELLOW, PAPER_ORANGE = "#2f6db5", "#eab308", "#e2661a"
"""Colours named in the caption of Fig. 4; their lightness also distinguishes them in print."""
JOINT_COLORS = (PAPER_BLUE, "#8e44ad", "#2e7d32")
LESS_IS_BETTER = "cividis_r"
"""Colour map for small quantities: light is good in every map, also in print and for colour-blind readers."""
LIGHT_IS_GOOD = "(light is better)"
INK, GREY, RED = "#1c1c1c", "#8c8c8c", "#c62828"
Look = Mapping[Any, bool | float]
PICTURE_STYLE: Look = {
    "figure.dpi": 110,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.alpha": 0.25,
    "legend.frameon": False,
}
BARE_STYLE: Look = {"axes.grid": False}
MAP_STYLE: Look = {"axes.grid": False, "axes.spines.top": True, "axes.spines.right": True}
OF_PROCESS = ("backend", "interactive", "toolbar", "timezone", "date.epoch")
"""Settings of matplotlib that belong to the process and do not affect a picture in a file."""


@dataclass
class Paper:
    """Request to save all pictures for a paper, too: formats ("svg", "pdf"), columns (1 or 2), files written so far."""

    formats: Sequence[str]
    columns: int
    written: list[Path] = field(default_factory=list)


_paper: ContextVar[Paper | None] = ContextVar("paper", default=None)


@contextmanager
def for_paper(formats: Sequence[str], columns: int = 2) -> Iterator[Paper]:
    """Save every picture drawn in the block also for a paper, in `formats` and as wide as so many `columns`."""
    paper = Paper(formats, columns)
    before = _paper.set(paper)
    try:
        yield paper
    finally:
        _paper.reset(before)


def write_for_paper(figure: "Figure", path: Path) -> None:
    """Save a figure for a paper next to `path`, if requested; this resizes the figure."""
    paper = _paper.get()
    if paper is None or not paper.formats:
        return
    # imported here, so that other users need not load it
    from matplotlib import rc_context

    _resize_for_paper(figure, paper.columns)
    # searchable text in PDF; reproducible element names in SVG
    with rc_context({"pdf.fonttype": 42, "svg.hashsalt": "twin"}):
        for form in paper.formats:
            vector = path.with_suffix(f".{form}")
            with atomic_write(vector) as beside:
                figure.savefig(beside, metadata=dict(NO_DATE[form]))
            paper.written.append(vector)


def _resize_for_paper(figure: "Figure", columns: int) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.text import Text

    width, height = figure.get_size_inches()
    stacked = _stack(figure) if columns == 1 else 0
    # letters shrink less than the picture and need more height
    figure.set_size_inches(
        COLUMN_WIDTHS[columns], stacked * PANEL_HEIGHT or 1.1 * COLUMN_WIDTHS[columns] * height / width
    )
    figure.set_layout_engine("constrained")
    for axes in figure.axes:
        if legend := axes.get_legend():
            # rebuild the legend, because its spacing depends on the font size at its creation
            names = [text.get_text() for text in legend.get_texts()]
            handles = [handle for handle in legend.legend_handles if handle is not None]
            loc: Any = getattr(legend, "_loc", "best")
            axes.legend(handles, names, loc=loc, fontsize=FONT_SIZE, frameon=False)
    for text in figure.findobj(Text):
        text.set_fontsize(FONT_SIZE)
    for line in figure.findobj(Line2D):
        line.set_linewidth(HEAVY_LINE if line.get_linewidth() > 1.0 else FINE_LINE)
        line.set_markersize(0.5 * line.get_markersize())


def _stack(figure: "Figure") -> int:
    """Stack a figure's side-by-side panels for a narrow column; return their number, 0 if the layout forbids it."""
    panels = [axes for axes in figure.axes if axes.get_visible() and axes.get_subplotspec()]
    places = [axes.get_subplotspec() for axes in panels]
    whole = {place.get_gridspec() for place in places if place}
    single = all(place and len(place.rowspan) == len(place.colspan) == 1 for place in places)
    if len(whole) != 1 or not single or len(panels) != len([axes for axes in figure.axes if axes.get_visible()]):
        return 0
    below = figure.add_gridspec(len(panels), 1)
    for row, axes in enumerate(panels):
        axes.set_subplotspec(below[row])
        axes.tick_params(labelbottom=True)
    return len(panels)


@contextmanager
def picture(
    path: Path, width: float, height: float, title: str = "", by_hand: bool = False, look: Look = PICTURE_STYLE
) -> Iterator[Figure]:
    """Yield a figure to draw on, and write it to `path` in the format of its suffix at the end of the block.

    The same figure gives the same bytes. See `for_paper` for copies for a paper.

    Args:
        width, height: in inches.
        look: changes to `PICTURE_STYLE`: `BARE_STYLE` or `MAP_STYLE`.
    """
    from matplotlib import rc_context, rcParamsDefault
    from matplotlib.figure import Figure

    # ignore the user's matplotlibrc
    defaults = {key: value for key, value in rcParamsDefault.items() if key not in OF_PROCESS}
    with rc_context({**defaults, **PICTURE_STYLE, **look}):
        figure = Figure(figsize=(width, height), layout=None if by_hand else "constrained")
        if title:
            figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
        yield figure
        with atomic_write(path) as beside:
            figure.savefig(beside, metadata={"Software": None})
        write_for_paper(figure, path)
