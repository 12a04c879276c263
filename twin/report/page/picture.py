"""The figure of the paper that fits the runs, as a picture in the page."""

import base64
import struct
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import replace

from twin.report.page.drawer import drawing
from twin.report.page.markup import Markup, element
from twin.report.page.run import ReportRun
from twin.report.page.verdict import PageVerdict
from twin.studies.paper.fig4_runs import Fig4Run
from twin.studies.paper.fig5 import Fig5Score, shown_tasks

CURVES = (
    "controller.F_z", "controller.F_z_ref", "controller.p_ref_B", "controller.p_cmd_B", "estimator.p_B",
    "estimator.F_ee_B", "plant.p_B", "plant.F_ee_B",
)  # fmt: skip


MAGNIFIED = 2.0
"""Most pixels of the page for a pixel of a picture."""


def picture(runs: Sequence[ReportRun], verdict: PageVerdict) -> AbstractContextManager[Callable[[], Markup | None]]:
    """What waits for a picture that is being drawn: Fig. 4 of its two runs, Fig. 5 of runs with tasks, one run laid out
    like Fig. 4; None if none of these fits."""
    if verdict.fig4 is not None:
        text = "Fig. 4 of the paper from these runs: A height, B pressing force, C, D force along x, y. "
        text += "Forces are the controller's estimates, dotted the truth."
        return _figure(runs, "twin.studies.paper.fig4_runs:draw_fig4", verdict.fig4, text)
    if verdict.fig5 is not None and (tasks := shown_tasks(verdict.fig5)):
        text = "Fig. 5 of the paper from these runs: the way of the platform, its position, the pressing force."
        # what was judged by cannot be pickled, and is not drawn
        score = Fig5Score(tuple(replace(task, findings=()) for task in tasks), ())
        return _figure(runs, "twin.studies.paper.fig5_picture:draw_fig5", score, text)
    if verdict.fig5 is None and len(runs) == 1 and runs[0].has(*CURVES):
        run = Fig4Run(runs[0].recording)
        if run.is_in_step:
            text = "Laid out like Fig. 4 of the paper: A height, B pressing force, C and D force along x and y."
            return _figure(runs, "twin.report.page.verdict:draw_one_run", run, text)
    return nullcontext(lambda: None)


@contextmanager
def _figure(runs: Sequence[ReportRun], draw: str, shown: object, text: str) -> Iterator[Callable[[], Markup]]:
    with drawing(draw, shown, sum(run.size for run in runs)) as content:
        yield lambda: figure(content(), text)


def figure(content: bytes, text: str) -> Markup:
    """A PNG picture inside the page, with its caption."""
    # a PNG file says its size right after its signature and the head of its first chunk; the page keeps that room free
    width, height = struct.unpack_from(">II", content, 16)
    source = f"data:image/png;base64,{base64.b64encode(content).decode('ascii')}"
    # a narrow one is no poster
    style = f"max-width: {MAGNIFIED * width:.0f}px"
    image = element(
        "img", src=source, alt=text, width=str(width), height=str(height), style=style, class_="picture"
    ).removesuffix("</img>")
    return element("figure", Markup(image), element("figcaption", text))
