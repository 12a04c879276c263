"""Picture of Fig. 4 from its runs, by the controller's estimates; the true force is dotted."""

from pathlib import Path
from typing import Any

import numpy as np

from twin.studies.figure import GREY, INK, PAPER_BLUE, PAPER_ORANGE, PAPER_YELLOW, picture
from twin.studies.panel import Panel, PanelCurve, Reader, Samples, draw_panel
from twin.studies.paper.fig4_measures import Fig4Run, Fig4Runs

MM_PER_M = 1e3
WIDE_LINE, THIN_LINE = 1.6, 0.9
"""Line widths (pt); noise drawn wide would be a block of colour."""
PAGE_BLUE, PAGE_VERMILION, PAGE_ORANGE, PAGE_BLACK = 0, 1, 4, 6
"""Indices of the page's colours that are nearest to the paper's."""
PRE_DEFINE, P_BASED, FP_BASED, FP_REFERENCE = PAPER_BLUE, PAPER_YELLOW, PAPER_ORANGE, GREY
TRUE_STYLE: dict[str, Any] = {"color": INK, "lw": THIN_LINE, "ls": ":"}
TRUE_P, TRUE_FP = "P-based, true", "F&P-based, true"
CURVE_STYLES: dict[str, dict[str, Any]] = {
    "Pre-define": {"color": PRE_DEFINE, "lw": WIDE_LINE}, "P-based": {"color": P_BASED, "lw": WIDE_LINE},
    "F&P-based": {"color": FP_BASED, "lw": WIDE_LINE}, "F&P-based-ref": {"color": FP_REFERENCE, "lw": THIN_LINE},
    TRUE_P: {**TRUE_STYLE, "label": "true force (plant)"}, TRUE_FP: {**TRUE_STYLE, "label": None},
}  # fmt: skip
"""Styles by label, in the order of the legends."""
FRICTION_STYLES = CURVE_STYLES | {name: {**CURVE_STYLES[name], "lw": THIN_LINE} for name in ("P-based", "F&P-based")}


def _of_run(name: str, curve: str, scale: float = 1.0, column: int | None = None) -> Reader:
    """Return a function that reads a curve of one of the runs of Fig. 4, at the rate of the curve."""

    def samples(runs: Fig4Runs) -> Samples | None:
        run: Fig4Run | None = getattr(runs, name)
        if run is None:
            return None
        values = getattr(run, curve)
        return run.t_plant if curve.startswith("true_") else run.t, scale * (
            values if column is None else values[:, column]
        )

    return samples


def _level(value: str = "") -> Reader:
    """Return a function that reads a constant of the force-position run of Fig. 4; 0 without a name."""

    def samples(runs: Fig4Runs) -> Samples:
        run = runs.force_position
        return run.t, np.full(len(run.t), getattr(run, value) if value else 0.0)

    return samples


def _friction(title: str, axis: int, position: str, force_position: str) -> Panel:
    return Panel(
        title, "N",
        (
            PanelCurve("Pre-define", "reference", _level(), PAGE_BLUE, shown=False, level=True),
            PanelCurve("P-based", "truth", _of_run(position, "F_ee_B", column=axis), PAGE_ORANGE),
            PanelCurve("F&P-based", "truth", _of_run(force_position, "F_ee_B", column=axis), PAGE_VERMILION),
        ),
    )  # fmt: skip


FIG4_PANELS = (
    Panel(
        "A: z position", "mm",
        (
            PanelCurve("Pre-define", "truth", _of_run("force_position", "z_ref", MM_PER_M), PAGE_BLUE),
            PanelCurve("P-based", "truth", _of_run("position", "z", MM_PER_M), PAGE_ORANGE),
            PanelCurve("F&P-based", "truth", _of_run("force_position", "z", MM_PER_M), PAGE_VERMILION),
            PanelCurve("F&P-based-ref", "reference", _of_run("force_position", "z_cmd", MM_PER_M), PAGE_BLACK),
        ),
    ),
    Panel(
        "B: F_z, pressing", "N",
        (
            PanelCurve("Pre-define", "truth", _level("F_z_ref"), PAGE_BLUE, level=True),
            PanelCurve("P-based", "truth", _of_run("position", "F_z"), PAGE_ORANGE),
            PanelCurve("F&P-based", "truth", _of_run("force_position", "F_z"), PAGE_VERMILION),
            PanelCurve(TRUE_P, "display", _of_run("position", "true_F_z"), PAGE_BLACK, shown=False),
            PanelCurve(TRUE_FP, "display", _of_run("force_position", "true_F_z"), PAGE_BLACK, shown=False),
        ),
    ),
    _friction("C: F_x, imperfect runs", 0, "imperfect_position", "imperfect_force_position"),
    _friction("D: F_y", 1, "position", "force_position"),
)  # fmt: skip


def draw_fig4(runs: Fig4Runs, path: Path) -> None:
    with picture(path, 12, 7.5) as figure:
        (a, b), (c, d) = figure.subplots(2, 2, sharex=True)
        places = ("upper right", "lower right", "lower left", "lower left")
        labels = ("z position (mm)", "F_z, pressing (N)", "F_x (N)", "F_y (N)")
        for axes, panel, place, label in zip((a, b, c, d), FIG4_PANELS, places, labels, strict=True):
            draw_panel(axes, panel, runs, CURVE_STYLES if axes in (a, b) else FRICTION_STYLES)
            axes.set_ylabel(label)
            axes.legend(loc=place)
            axes.set_title(panel.title[0], loc="left", fontweight="bold")
            axes.set_xlim(0, 20)
        limits = [min(c.get_ylim()[0], d.get_ylim()[0]), max(c.get_ylim()[1], d.get_ylim()[1])]
        c.set_ylim(*limits)
        d.set_ylim(*limits)
        # by symmetry, ideal runs have no force in x
        text = runs.without_x or "imperfect runs: scale tilted, encoders off zero"
        c.set_title(text, loc="right", fontsize="small")
        for axes in (c, d):
            axes.set_xlabel("time (s)")
