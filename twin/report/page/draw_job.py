"""The drawing process; imports matplotlib before it receives its task."""

import pickle
from pathlib import Path

import matplotlib.backends.backend_agg  # noqa: F401

import twin.report.page.picture
import twin.studies.paper.fig4_figure
import twin.studies.paper.fig5_figure  # noqa: F401
from twin.kernel.process.job import load_function
from twin.kernel.process.reporter import Reporter


def draw_picture(reporter: Reporter, draw: str, shown: Path, path: Path) -> None:
    """Draw a picture to `path` by calling the function `draw` with unpickled data; a job for guarded processes."""
    with shown.open("rb") as file:
        content = pickle.load(file)
    load_function(draw)(content, path)
