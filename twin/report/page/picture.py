"""The picture of a report: the paper's figure of its runs, or one run in the layout of Fig. 4."""

import base64
import pickle
import struct
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path

from twin.kernel.process.job import load_function
from twin.kernel.process.process import GuardedProcess, claim_process
from twin.report.page import DRAW_JOB
from twin.report.page.markup import Markup, element
from twin.report.page.panels import RUN_PANELS, PanelRun, series
from twin.report.page.run import ReportRun
from twin.report.page.verdict import PageVerdict
from twin.studies import figure as style
from twin.studies.panel import Panel, PanelCurve, draw_panel
from twin.studies.paper.fig4_figure import FP_BASED, FP_REFERENCE, PRE_DEFINE, THIN_LINE, TRUE_STYLE, WIDE_LINE
from twin.studies.paper.fig4_measures import Fig4Run
from twin.studies.paper.fig5 import Fig5Score, shown_tasks

POLL_INTERVAL, DRAW_TIMEOUT = 0.05, 60.0
"""Interval (s) at which the drawing process is checked, and timeout (s) of drawing."""
MAX_PICKLE_BYTES = 200_000_000
"""Maximum size of data passed to the drawing process (bytes); more would cost too much time and disk space."""
FIG4_SERIES = (
    "controller.F_z", "controller.F_z_ref", "controller.p_ref_B", "controller.p_cmd_B", "estimator.p_B",
    "estimator.F_ee_B", "plant.p_B", "plant.F_ee_B",
)  # fmt: skip
"""Series that a run in the layout of Fig. 4 needs."""
MAX_MAGNIFICATION = 2.0
ROLE_STYLES = {
    "shifted": {"color": FP_REFERENCE, "lw": 1.2}, "reference": {"color": PRE_DEFINE, "lw": WIDE_LINE},
    "belief": {"color": FP_BASED, "lw": WIDE_LINE}, "truth": TRUE_STYLE,
}  # fmt: skip
FRICTION_STYLES = {"belief": {"color": FP_BASED, "lw": THIN_LINE}, "truth": TRUE_STYLE}


@contextmanager
def drawing(draw: str, shown: object, size: int = 0) -> Iterator[Callable[[], bytes]]:
    """Start drawing a picture, if possible in another process; yield a function that waits for its PNG bytes.

    `draw` is "module:function", called with picklable data, about `size` bytes, as `draw(shown, path)`.
    """
    waiting = claim_process(DRAW_JOB) if size <= MAX_PICKLE_BYTES else None
    with tempfile.TemporaryDirectory() as folder, waiting or nullcontext() as process:
        path, handed_over = Path(folder) / "picture.png", Path(folder) / "shown"
        if process:
            try:
                with handed_over.open("wb") as file:
                    # protocol 5 writes arrays to the file without a copy
                    pickle.dump(shown, file, protocol=5)
                process.start({"draw": draw, "shown": handed_over, "path": path})
            except OSError:
                process = None

        def content() -> bytes:
            if process is None or not _wait_until_done(process):
                load_function(draw)(shown, path)
            return path.read_bytes()

        yield content


def _wait_until_done(process: GuardedProcess) -> bool:
    """Wait for the drawing process; return whether it succeeded. If not, the caller draws the picture itself."""
    while not process.gone and process.age < DRAW_TIMEOUT:
        for report in process.reports(POLL_INTERVAL):
            return "finished" in report
    return False


def picture(runs: Sequence[ReportRun], verdict: PageVerdict) -> AbstractContextManager[Callable[[], Markup | None]]:
    """Start drawing the report's picture of `runs`; the context manager yields a function that waits for the picture.

    Fig. 4 for its two runs, Fig. 5 for runs with tasks, the layout of Fig. 4 for one run; None for any other runs.
    """
    if verdict.fig4 is not None:
        text = "Fig. 4 of the paper from these runs: A height, B pressing force, C, D force along x, y. "
        text += "Forces are the controller's estimates, dotted the truth."
        return _figure(runs, "twin.studies.paper.fig4_figure:draw_fig4", verdict.fig4, text)
    if verdict.fig5 is not None and (tasks := shown_tasks(verdict.fig5)):
        text = "Fig. 5 of the paper from these runs: the way of the platform, its position, the pressing force."
        # findings cannot be pickled and are not drawn
        score = Fig5Score(tuple(replace(task, findings=()) for task in tasks), ())
        return _figure(runs, "twin.studies.paper.fig5_figure:draw_fig5", score, text)
    if verdict.fig5 is None and len(runs) == 1 and runs[0].has(*FIG4_SERIES) and Fig4Run(runs[0].recording).is_in_step:
        text = "Laid out like Fig. 4 of the paper: A height, B pressing force, C and D force along x and y."
        return _figure(runs, "twin.report.page.picture:draw_one_run", PanelRun(runs[0].recording, {}), text)
    return nullcontext(lambda: None)


@contextmanager
def _figure(runs: Sequence[ReportRun], draw: str, shown: object, text: str) -> Iterator[Callable[[], Markup]]:
    with drawing(draw, shown, sum(run.size for run in runs)) as content:
        yield lambda: figure(content(), text)


def figure(content: bytes, text: str) -> Markup:
    """Return an HTML figure with an embedded PNG picture and its caption."""
    # the size is at a fixed offset of a PNG file; with it the browser reserves the space
    width, height = struct.unpack_from(">II", content, 16)
    source = f"data:image/png;base64,{base64.b64encode(content).decode('ascii')}"
    # limit the magnification of narrow pictures
    style = f"max-width: {MAX_MAGNIFICATION * width:.0f}px"
    image = element(
        "img", src=source, alt=text, width=str(width), height=str(height), style=style, class_="picture"
    ).removesuffix("</img>")
    return element("figure", Markup(image), element("figcaption", text))


def draw_one_run(run: PanelRun, path: Path) -> None:
    """Write the picture of one run to `path` (PNG): the robot's own estimates coloured, the true signals dotted."""
    friction = [
        Panel(f"F_{letter}", "N", (
            PanelCurve("estimated", "belief", series("estimator.F_ee_B", axis)),
            PanelCurve("true", "truth", series("plant.F_ee_B", axis)),
        )) for axis, letter in enumerate("xy")
    ]  # fmt: skip
    force, height = RUN_PANELS[:2]
    labels = ("z position (mm)", "F_z, pressing (N)", "F_x (N)", "F_y (N)")
    with style.picture(path, 12, 7.5, by_hand=True) as figure:
        grid = figure.subplots(2, 2, sharex=True)
        # an automatic layout would draw everything twice
        figure.subplots_adjust(left=0.075, right=0.99, top=0.96, bottom=0.07, hspace=0.12, wspace=0.2)
        for axes, panel, letter, label in zip(grid.flat, (height, force, *friction), "ABCD", labels, strict=True):
            draw_panel(axes, panel, run, FRICTION_STYLES if panel in friction else ROLE_STYLES)
            axes.set_ylabel(label)
            axes.set_title(letter, loc="left", fontweight="bold")
            axes.legend()
        for axes in grid[1]:
            axes.set_xlabel("time (s)")
