"""The way of one task in space, in a black box with arrows, as the paper's Fig. 5 shows it."""

from contextlib import suppress
from itertools import product

import numpy as np
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from mpl_toolkits.mplot3d.axes3d import Axes3D

from twin.controller.phase import PhaseKind
from twin.experiment.task import Push, Roll
from twin.recording.errors import UnknownSeries
from twin.studies.figure import BLUE, GREY, INK, VERMILION
from twin.studies.paper.fig5_runs import TaskRun, settings

TRUTH, REFERENCE, TRACE, MOVING = INK, GREY, VERMILION, BLUE
"""Truth black, reference grey; the paper's red and blue in the shades of Okabe and Ito."""
SURFACE = "#f2d9c4"
REACH = 25.0
"""Half the width of the box (mm): the shipped tasks stay within 20 mm of the axis."""
TOP = -86.0
MARGIN = 3.0
HEIGHT = 0.75
"""Height of the box over its width as drawn; z is drawn larger than x and y."""
WORK = (PhaseKind.HOLD, PhaseKind.CIRCLE, PhaseKind.PUSH, PhaseKind.TAP, PhaseKind.RISE)


def draw_in_space(axes: Axes3D, run: TaskRun, floor: float) -> None:
    """Draw the task into `axes`.

    Args:
        run: has samples.
        floor: lowest height that any of the pictures shows (m).
    """
    bottom = 1e3 * floor - MARGIN
    # in the order written: matplotlib's own guess of what lies in front hides traces that are in the surface
    axes.computed_zorder = False
    _draw_box(axes, bottom)
    _draw_surface(axes, 1e3 * _height(run))
    p = 1e3 * run.p_B
    working = np.isin(run.phase, WORK)
    with suppress(UnknownSeries):
        axes.plot(*(1e3 * run.commanded("p_ref_B")).T, color=REFERENCE, lw=1.2, ls="--", zorder=2)
    axes.plot(*p.T, color=TRUTH, lw=1.0, zorder=3)
    axes.plot(*np.where(working[:, None], p, np.nan).T, color=TRACE, lw=2.2, zorder=4)
    for start, way in _moves(run):
        axes.quiver(*start, *way, color=MOVING, lw=1.8, arrow_length_ratio=0.3, zorder=5, label="moving direction")
    axes.set(xlim=(-REACH, REACH), ylim=(-REACH, REACH), zlim=(bottom, TOP))
    axes.set_box_aspect((1, 1, HEIGHT), zoom=1.06)
    axes.view_init(elev=24, azim=-52)
    for axis, letter in zip((axes.xaxis, axes.yaxis, axes.zaxis), "xyz", strict=True):
        axis.set_label_text(f"{letter} (mm)", fontsize=8)
        axis.labelpad = -6
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
    axes.tick_params(labelsize=7, pad=-3)
    axes.grid(False)


def _height(run: TaskRun) -> float:
    """Height of the untouched surface (m)."""
    return float(settings(run.recording)["contact"]["height_mm"]) / 1e3


def _draw_box(axes: Axes3D, bottom: float) -> None:
    """The twelve edges."""
    corners = np.array(list(product((-REACH, REACH), (-REACH, REACH), (bottom, TOP))))
    for i, a in enumerate(corners):
        for b in corners[i + 1 :]:
            if np.count_nonzero(a != b) == 1:
                axes.plot(*np.transpose([a, b]), color="black", lw=0.9, zorder=1, clip_on=False)


def _draw_surface(axes: Axes3D, height: float) -> None:
    corners = [(-REACH, -REACH, height), (REACH, -REACH, height), (REACH, REACH, height), (-REACH, REACH, height)]
    axes.add_collection3d(Poly3DCollection([corners], facecolor=SURFACE, alpha=0.6, edgecolor="none", zorder=0))


def _moves(run: TaskRun) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    """(start, way) of the arrows in mm: down beside the point; around the circle or along the line."""
    x, y = (1e3 * c for c in run.task.point)
    high, low = -88.0, 1e3 * _height(run) + 1.0
    moves: list[tuple[tuple[float, ...], tuple[float, ...]]] = [((x - 3.0, y, high), (0.0, 0.0, low - high))]
    level = 1e3 * _height(run)
    match run.task:
        case Push():
            way = 1e3 * np.subtract(run.task.to, run.task.point)
            moves.append(((x + 5.0, y + 0.25 * way[1], level), (0.5 * way[0], 0.5 * way[1], 0.0)))
        case Roll():
            r = 1e3 * run.task.radius
            moves.append(((x + 1.8 * r, y - r, level), (0.0, 2.0 * r, 0.0)))
    return moves
