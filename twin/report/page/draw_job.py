"""The process that draws pictures; it imports matplotlib before it knows which."""

import pickle
from pathlib import Path

import matplotlib.backends.backend_agg  # noqa: F401

import twin.report.page.picture
import twin.studies.paper.fig4_figure
import twin.studies.paper.fig5_figure  # noqa: F401
from twin.kernel.process.job import load_function
from twin.kernel.process.reporter import Reporter


def draw_picture(reporter: Reporter, draw: str, shown: Path, path: Path) -> None:
    """A job of the guard: call the function `draw` with what the file `shown` holds (pickled); `path`: the picture."""
    with shown.open("rb") as file:
        content = pickle.load(file)
    load_function(draw)(content, path)
