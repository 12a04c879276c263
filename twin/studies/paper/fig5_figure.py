"""Picture of Fig. 5 from runs of tasks: path in space, position, pressing force."""

import math
from collections.abc import Callable
from contextlib import suppress
from itertools import combinations, product
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.patches import Circle

from twin.kernel.errors import UnknownSeries
from twin.robot.controller.program import PhaseKind, Push, Roll, Tap
from twin.robot.experiment.source import names_stand_in
from twin.robot.monitor.limits import Monitor
from twin.studies.figure import BLUE, GREEN, GREY, INK, ORANGE, VERMILION, Axes, picture
from twin.studies.metrics.response import along_and_off
from twin.studies.paper.claim import Claim
from twin.studies.paper.fig5 import TASK_CLAIMS, Fig5Score, shown_tasks
from twin.studies.paper.task_run import TaskRun, settings

if TYPE_CHECKING:
    from mpl_toolkits.mplot3d.axes3d import Axes3D

TRUTH_COLOR, REFERENCE_COLOR, TRACE_COLOR, MOTION_COLOR = INK, GREY, VERMILION, BLUE
"""Truth black, reference grey; the paper's red and blue in the shades of Okabe and Ito."""
SURFACE_COLOR = "#f2d9c4"
BOX_HALF_WIDTH = 25.0
"""Half the width of the box (mm): the shipped tasks stay within 20 mm of the axis."""
BOX_TOP = -86.0
BOX_MARGIN = 3.0
BOX_HEIGHT_RATIO = 0.75
"""Height of the drawn box over its width; z has a larger scale than x and y."""
WORKING_PHASES = (PhaseKind.HOLD, PhaseKind.CIRCLE, PhaseKind.PUSH, PhaseKind.TAP, PhaseKind.RISE)
ESTIMATE_COLOR, SHIFTED_COLOR = ORANGE, GREEN
JUDGED_COLOR = "#e9eef5"
COLUMN_WIDTH, LEFT_MARGIN, RIGHT_MARGIN = 3.5, 0.803, 0.4088
"""Widths (in) of a task's panels, and of the left and right margins for the axis labels."""
LEGEND_COLUMNS = 2
"""Number of legend entries that fit side by side below a task's panels."""
TASK_PHASES = {"press": PhaseKind.HOLD, "roll": PhaseKind.CIRCLE, "push": PhaseKind.PUSH}
LIMIT_SHARE = 0.35
"""Maximum excess of the monitor's limit over the force, as a share, for both to fit one axis."""
TASK_TITLES = {"press": "A  Pressing", "tap": "B  Tapping", "roll": "C  Rolling", "push": "D  Pushing"}
SHOWN_TAPS = 3


def draw_fig5(score: Fig5Score, path: Path) -> None:
    """Draw Fig. 5 to `path` (PNG), a column per task; a series that a run lacks is left out."""
    shown = shown_tasks(score)
    width = COLUMN_WIDTH * len(shown) + 0.6
    with picture(path, width, 9.6, by_hand=True) as figure:
        grid = figure.add_gridspec(
            3, len(shown), height_ratios=(1.45, 1.0, 1.0), hspace=0.24, wspace=0.28,
            left=LEFT_MARGIN / width, right=1.0 - RIGHT_MARGIN / width, top=0.92,
            bottom=0.08 + 0.02 * math.ceil(4 / len(shown)),
        )  # fmt: skip
        floor = min(float(task.run.p_B[:, 2].min()) for task in shown)
        for column, task in enumerate(shown):
            space = figure.add_subplot(grid[0, column], projection="3d")
            draw_in_space(space, task.run, floor)
            corner = {"transform": space.transAxes, "va": "bottom"}
            space.text2D(0.0, 1.115, TASK_TITLES[task.kind], fontweight="bold", fontsize=12, **corner)
            place = f"{task.drive} on {task.body}{', safety monitor tripped' * task.run.has_trip}"
            space.text2D(0.0, 1.0, f"{task.manner}\n{place}", fontsize=8, **corner)
            way, force = (figure.add_subplot(grid[row, column]) for row in (1, 2))
            PATH_PANELS[task.kind](way, task.run)
            _draw_force(force, task.run)
            for axes in (way, force):
                axes.tick_params(labelsize=8)
        found = [axes.get_legend_handles_labels() for axes in figure.axes]
        marks = {label: mark for marks, labels in found for mark, label in zip(marks, labels, strict=True)}
        columns = min(len(marks), LEGEND_COLUMNS * len(shown))
        figure.legend(marks.values(), marks.keys(), loc="lower center", ncols=columns, fontsize=9)


def _draw_height(axes: Axes, run: TaskRun) -> None:
    seen = seen_part(run)
    t = run.t[seen]
    for name, color, style, label in (
        ("p_cmd_B", SHIFTED_COLOR, "-", "after the force loop"),
        ("p_ref_B", REFERENCE_COLOR, "--", "reference"),
    ):
        with suppress(UnknownSeries):
            axes.plot(t, 1e3 * run.controller_series(name)[seen, 2], color=color, lw=1.6, ls=style, label=label)
    axes.plot(t, 1e3 * run.p_B[seen, 2], color=TRUTH_COLOR, lw=1.2, label="true")
    axes.set(xlabel="time (s)", ylabel="z (mm)", xlim=(t[0], t[-1]))


def _draw_circle(axes: Axes, run: TaskRun) -> None:
    assert isinstance(run.task, Roll)
    circling = run.phase_mask(PhaseKind.CIRCLE)
    x, y = 1e3 * run.p_B[circling, 0], 1e3 * run.p_B[circling, 1]
    axes.plot(x, y, color="#bbbbbb", lw=0.8)
    axes.plot(*(1e3 * run.p_B[run.full_turns, i] for i in (0, 1)), color=TRACE_COLOR, lw=1.6, label="trace under force")
    axes.add_patch(_ring(run.task, 1.0, color=REFERENCE_COLOR, lw=1.6, ls="--", label="reference"))
    claim = bound_of("radius")
    for bound in (claim.low, claim.high):
        axes.add_patch(_ring(run.task, bound / claim.scale, color=REFERENCE_COLOR, lw=1.0, ls=":", label="bound"))
    axes.set(xlabel="x (mm)", ylabel="y (mm)")
    axes.set_aspect("equal", adjustable="datalim")


def _ring(task: Roll, share: float, **look: Any) -> Circle:
    """Return a circle about the task's point with a share of the requested radius, in mm."""
    return Circle((1e3 * task.point[0], 1e3 * task.point[1]), 1e3 * share * task.radius, fill=False, **look)


def _draw_line(axes: Axes, run: TaskRun) -> None:
    assert isinstance(run.task, Push)
    along, off = along_and_off(run.p_B[run.phase_mask(PhaseKind.PUSH), :2], run.task.point, run.task.to)
    axes.plot(1e3 * along, 1e3 * off, color=TRACE_COLOR, lw=1.8, label="trace under force")
    axes.axhline(0.0, color=REFERENCE_COLOR, lw=1.6, ls="--", label="reference")
    for side in (-1.0, 1.0):
        axes.axhline(side * bound_of("line_worst").high, color=REFERENCE_COLOR, lw=1.0, ls=":", label="bound")
    axes.set(xlabel="along the line (mm)", ylabel="off the line (mm)")


PATH_PANELS: dict[str, Callable[[Axes, TaskRun], None]] = {
    "press": _draw_height,
    "tap": _draw_height,
    "roll": _draw_circle,
    "push": _draw_line,
}


def _draw_force(axes: Axes, run: TaskRun) -> None:
    seen = seen_part(run)
    t = run.t[seen]
    on = run.full_turns if isinstance(run.task, Roll) else run.phase_mask(TASK_PHASES.get(run.task.kind, PhaseKind.TAP))
    if not isinstance(run.task, Tap) and np.any(on):
        axes.axvspan(run.t[on][0], run.t[on][-1], color=JUDGED_COLOR, lw=0, label="judged")
    with suppress(UnknownSeries):
        axes.plot(t, run.controller_series("F_z")[seen], color=ESTIMATE_COLOR, lw=1.6, label="estimated")
    axes.plot(t, run.F_z[seen], color=TRUTH_COLOR, lw=1.1, label="true")
    if isinstance(run.task, Tap):
        axes.axhline(run.task.force, color=REFERENCE_COLOR, lw=1.6, ls="--", label="reference")
    else:
        with suppress(UnknownSeries):
            axes.plot(
                t, run.controller_series("F_z_ref")[seen], color=REFERENCE_COLOR, lw=1.6, ls="--", label="reference"
            )
    limit = _force_limit(run)
    if limit is not None and limit <= (1.0 + LIMIT_SHARE) * max(run.F_z.max(), run.task.force):
        axes.axhline(limit, color=TRACE_COLOR, lw=1.2, ls=":", label="monitor's limit")
    axes.set(xlabel="time (s)", ylabel="pressing force F_z (N)", xlim=(t[0], t[-1]))
    axes.set_ylim(-0.12 * run.task.force, max(axes.get_ylim()[1], 1.06 * run.task.force))


def _force_limit(run: TaskRun) -> float | None:
    """Return the safety monitor's trip limit for the force (N); None without twin's own monitor."""
    table = settings(run.recording).get("monitor")
    if table is None or names_stand_in(table):
        return None
    return Monitor.model_validate(table).force_limit


def seen_part(run: TaskRun) -> slice:
    """Return the samples of a task that its panels show over time: the whole task, or the last taps."""
    if isinstance(run.task, Tap) and len(run.taps) > 1:
        last = run.taps[-SHOWN_TAPS:]
        return slice(last[0].start, last[-1].start + round(run.task.period / (run.t[1] - run.t[0])))
    return slice(0, len(run.t))


def bound_of(key: str) -> Claim:
    return next(claim for claims in TASK_CLAIMS.values() for claim in claims if claim.key == key)


def draw_in_space(axes: "Axes3D", run: TaskRun, floor: float) -> None:
    """Draw the spatial path of a massage task into `axes` above `floor`, the lowest height of all panels (m)."""
    bottom = 1e3 * floor - BOX_MARGIN
    # drawn in source order: matplotlib's own depth sorting hides traces within the surface
    axes.computed_zorder = False
    _draw_box(axes, bottom)
    _draw_surface(axes, 1e3 * _height(run))
    p = 1e3 * run.p_B
    working = np.isin(run.phase, WORKING_PHASES)
    with suppress(UnknownSeries):
        axes.plot(*(1e3 * run.controller_series("p_ref_B")).T, color=REFERENCE_COLOR, lw=1.2, ls="--", zorder=2)
    axes.plot(*p.T, color=TRUTH_COLOR, lw=1.0, zorder=3)
    axes.plot(*np.where(working[:, None], p, np.nan).T, color=TRACE_COLOR, lw=2.2, zorder=4)
    for start, way in _moves(run):
        axes.quiver(
            *start, *way, color=MOTION_COLOR, lw=1.8, arrow_length_ratio=0.3, zorder=5, label="moving direction"
        )
    axes.set(xlim=(-BOX_HALF_WIDTH, BOX_HALF_WIDTH), ylim=(-BOX_HALF_WIDTH, BOX_HALF_WIDTH), zlim=(bottom, BOX_TOP))
    axes.set_box_aspect((1, 1, BOX_HEIGHT_RATIO), zoom=1.06)
    axes.view_init(elev=24, azim=-52)
    for axis, letter in zip((axes.xaxis, axes.yaxis, axes.zaxis), "xyz", strict=True):
        axis.set_label_text(f"{letter} (mm)", fontsize=8)
        axis.labelpad = -6
        axis.set_pane_color((1.0, 1.0, 1.0, 0.0))
    axes.tick_params(labelsize=7, pad=-3)
    axes.grid(False)


def _height(run: TaskRun) -> float:
    """Return the height of the untouched surface (m) in a run."""
    return float(settings(run.recording)["contact"]["height_mm"]) / 1e3


def _draw_box(axes: "Axes3D", bottom: float) -> None:
    sides = (-BOX_HALF_WIDTH, BOX_HALF_WIDTH)
    for a, b in combinations(product(sides, sides, (bottom, BOX_TOP)), 2):
        if np.count_nonzero(np.not_equal(a, b)) == 1:
            axes.plot(*np.transpose([a, b]), color="black", lw=0.9, zorder=1, clip_on=False)


def _draw_surface(axes: "Axes3D", height: float) -> None:
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    corners = [(x * BOX_HALF_WIDTH, y * BOX_HALF_WIDTH, height) for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    axes.add_collection3d(Poly3DCollection([corners], facecolor=SURFACE_COLOR, alpha=0.6, edgecolor="none", zorder=0))


def _moves(run: TaskRun) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    """Return (start, vector), mm, of a task's arrows: down beside the point, or around the circle, along the line."""
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
