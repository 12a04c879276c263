"""Steps before and after tuning as a picture: predicted and simulated, at each corner."""

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from twin.report.tuning_text import corner_name
from twin.tuning.prediction import HORIZON, step_response
from twin.tuning.tuned import Judged, Tuned, worst_places

BEFORE, AFTER, GREY = "#8c8c8c", "#0072b2", "#d9d9d9"
COLUMNS = 4


def draw_tuning(done: Tuned, path: Path) -> None:
    """Write the picture to `path` (PNG): one panel per drive, law and stiffness, the step as a share of its end."""
    shown = worst_places(done.after.predictions)
    columns = min(COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    figure = Figure(figsize=(3.4 * max(columns, 2), 2.7 * rows + 1.2), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    grid = figure.subplots(rows, columns, squeeze=False)
    for axes in grid.flat[len(shown) :]:
        axes.set_axis_off()
    for axes, i in zip(grid.flat, shown, strict=False):
        corner = done.after.predictions[i].corner
        _draw(axes, done.before, i, BEFORE, "before")
        _draw(axes, done.after, i, AFTER, "after")
        top = 1.0 + done.goals.overshoot
        axes.axhspan(0.95, 1.05, color=GREY, lw=0, zorder=0)
        axes.axhline(top, color=GREY, lw=0.8)
        axes.set(xlim=(0.0, _span(done.after, i)), ylim=(-0.1, max(1.3, top + 0.1)))
        axes.set_title(f"{corner_name(corner)}\n{Path(corner.drive).stem}", loc="left", fontsize=9)
        axes.set_xlabel("time since the step (s)", fontsize=8)
        axes.tick_params(labelsize=8)
        axes.spines[["top", "right"]].set_visible(False)
    # a panel without a trial, or of an unstable loop, has fewer lines
    handles, labels = max((axes.get_legend_handles_labels() for axes in grid.flat), key=lambda found: len(found[1]))
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    verdict = "goals met" if done.met else "GOALS NOT MET"
    title = f"Steps of {done.experiments[0].name}, share of the step: {verdict}"
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
    figure.savefig(path, metadata={"Software": None})


def _draw(axes: Axes, judged: Judged, i: int, color: str, name: str) -> None:
    prediction, trial = judged.predictions[i], judged.trials.get(i)
    if trial is not None:
        axes.plot(trial.t, trial.share, color=color, lw=0.9, alpha=0.6, label=f"{name}, simulated")
    if prediction.stable:
        axis = 3 if prediction.corner.point.force_on else 2
        t, y, final = step_response(prediction.corner, judged.gains, axis)
        axes.plot(t, y / final, color=color, lw=1.3, ls="--", label=f"{name}, predicted")


def _span(judged: Judged, i: int) -> float:
    """Time (s) that shows the step and some of the rest after it."""
    settling = max((found.settling for found in judged.predictions[i].answers.values()), default=HORIZON)
    return float(np.clip(4.0 * settling, 0.5, HORIZON)) if math.isfinite(settling) else HORIZON
