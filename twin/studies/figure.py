"""Style and saving of pictures."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from twin.kernel.writing import written
from twin.studies.paper_figure import write_for_paper

if TYPE_CHECKING:
    from matplotlib.axes import Axes as Axes
    from matplotlib.figure import Figure as Figure
else:
    # matplotlib takes a while to load, and most of what a study says is text
    Axes = Figure = Any

BLUE, ORANGE, GREEN, PINK, VERMILION, SKY = "#0072b2", "#e69f00", "#009e73", "#cc79a7", "#d55e00", "#56b4e9"
"""Okabe and Ito's (https://jfly.uni-koeln.de/color), which colour-blind readers can tell apart."""
PAPER_BLUE, PAPER_YELLOW, PAPER_ORANGE = "#2f6db5", "#eab308", "#e2661a"
"""As the caption of Fig. 4 names them; their lightness also tells them apart in print."""
JOINTS = (PAPER_BLUE, "#8e44ad", "#2e7d32")
LESS_IS_BETTER = "cividis_r"
"""Colours of a map of something of which less is better. In every map light is good, so that they read alike, also in
print; made for colour-blind readers."""
LIGHT_IS_GOOD = "(light is better)"
INK, GREY, RED = "#1c1c1c", "#8c8c8c", "#c62828"
Look = Mapping[Any, bool | float]
LOOK: Look = {
    "figure.dpi": 110,
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.alpha": 0.25,
    "legend.frameon": False,
}
BARE: Look = {"axes.grid": False}
MAP: Look = {"axes.grid": False, "axes.spines.top": True, "axes.spines.right": True}
"""Of a panel that is filled."""


@contextmanager
def picture(
    path: Path, width: float, height: float, title: str = "", by_hand: bool = False, look: Look = LOOK
) -> Iterator[Figure]:
    """A figure to draw on, written to `path`, in the format of its suffix, when the block is done; see `for_paper`.

    The same figure gives the same bytes.

    Args:
        path: of the picture.
        width, height: in inches.
        title: above all panels.
        by_hand: panels are placed by the code that draws them.
        look: what of `LOOK` is otherwise: `BARE` or `MAP`.

    Raises:
        NotWritten: the folder or the disk refuses.
    """
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context({**LOOK, **look}):
        figure = Figure(figsize=(width, height), layout=None if by_hand else "constrained")
        if title:
            figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
        yield figure
        with written(path) as beside:
            figure.savefig(beside, metadata={"Software": None})
        write_for_paper(figure, path)
