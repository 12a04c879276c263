"""The figure of the paper that fits the runs, as a picture in the page."""

import base64
import struct
import tempfile
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path

from twin.report.page.markup import Markup, element
from twin.report.page.run import ReportRun
from twin.report.page.verdict import PageVerdict
from twin.studies.paper.fig4_runs import Fig4Run

CURVES = (
    "controller.F_z", "controller.F_z_ref", "controller.p_ref_B", "controller.p_cmd_B", "estimator.p_B",
    "estimator.F_ee_B", "plant.p_B", "plant.F_ee_B",
)  # fmt: skip


MAGNIFIED = 2.0
"""Most pixels of the page for a pixel of a picture."""


def picture(runs: Sequence[ReportRun], verdict: PageVerdict) -> Markup | None:
    """Fig. 4 of its two runs, Fig. 5 of runs with tasks, one run laid out like Fig. 4; None if none of these fits."""
    if verdict.fig4 is not None:
        from twin.studies.paper.fig4_picture import draw_fig4

        text = "Fig. 4 of the paper from these runs: A height, B pressing force, C, D force along x, y. "
        text += "Forces are the controller's estimates, dotted the truth."
        return _figure(partial(draw_fig4, verdict.fig4), text)
    if verdict.fig5 is not None:
        from twin.studies.paper.fig5_picture import draw_fig5, shown_tasks

        if not shown_tasks(verdict.fig5):
            return None
        text = "Fig. 5 of the paper from these runs: the way of the platform, its position, the pressing force."
        return _figure(partial(draw_fig5, verdict.fig5), text)
    if len(runs) == 1 and runs[0].has(*CURVES) and Fig4Run(runs[0].recording).is_in_step:
        from twin.report.page.one_run import draw_one_run

        text = "Laid out like Fig. 4 of the paper: A height, B pressing force, C and D force along x and y."
        return _figure(partial(draw_one_run, Fig4Run(runs[0].recording)), text)
    return None


def _figure(draw: Callable[[Path], None], text: str) -> Markup:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "picture.png"
        draw(path)
        return figure(path.read_bytes(), text)


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
