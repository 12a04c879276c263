"""Tuning as a picture: at each corner steps, predicted and simulated, and sensitivity, before and after."""

import math
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from twin.studies.figure import BARE, BLUE, GREY, picture
from twin.studies.tune.prediction import HORIZON, SETTLED, sensitivities, step_response
from twin.studies.tune.tuned import Judged, Tuned, worst_places

BEFORE, AFTER, PALE = GREY, BLUE, "#d9d9d9"
COLUMNS = 4
LOOKED_AT = (0.02, 200.0)
"""Frequencies (Hz) of the sensitivities."""


def draw_tuning(done: Tuned, path: Path) -> None:
    """Write the picture to `path` (PNG): of each drive, law and stiffness the step and, below it, the sensitivity."""
    shown = worst_places(done.after.predictions)
    columns = min(COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    title = f"{done.experiments[0].name}, tuned: {'goals met' if done.met else 'GOALS NOT MET'}"
    with picture(path, 3.4 * max(columns, 2), 4.6 * rows + 0.9, title, look=BARE) as figure:
        grid = figure.subplots(2 * rows, columns, squeeze=False, height_ratios=[1.3, 1.0] * rows)
        for axes in grid.flat:
            axes.set_axis_off()
        for k, i in enumerate(shown):
            row, column = 2 * (k // columns), k % columns
            _draw_steps(grid[row, column], done, i)
            _draw_sensitivity(grid[row + 1, column], done, i)
            for axes, label in zip(grid[row : row + 2, 0], ("share of the step", "largest |1/(1+L)|"), strict=True):
                axes.set_ylabel(label, fontsize=8)
        # a panel without a trial, or of an unstable loop, has fewer lines
        handles, labels = max((axes.get_legend_handles_labels() for axes in grid.flat), key=lambda found: len(found[1]))
        figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=9)


def _draw_steps(axes: Axes, done: Tuned, i: int) -> None:
    corner, top = done.after.predictions[i].corner, 1.0 + done.goals.overshoot
    _draw(axes, done.before, i, BEFORE, "before")
    _draw(axes, done.after, i, AFTER, "after")
    axes.axhspan(1.0 - SETTLED, 1.0 + SETTLED, color=PALE, lw=0, zorder=0)
    axes.axhline(top, color=PALE, lw=0.8)
    axes.set(xlim=(0.0, _span(done.after, i)), ylim=(-0.1, max(1.3, top + 0.1)))
    axes.set_title(f"{corner.name}\n{Path(corner.drive).stem}", loc="left", fontsize=9)
    _dressed(axes, "time since the step (s)")


def _draw_sensitivity(axes: Axes, done: Tuned, i: int) -> None:
    """Of all loops at the corner the largest, predicted, and what it may be at most."""
    for judged, color in ((done.before, BEFORE), (done.after, AFTER)):
        prediction = judged.predictions[i]
        if prediction.stable:
            S = np.abs(sensitivities(prediction.corner, judged.gains)).max(axis=1)
            axes.semilogx(prediction.corner.omega / (2.0 * np.pi), S, color=color, lw=1.3, ls="--")
    axes.axhline(done.goals.sensitivity, color=PALE, lw=0.8)
    axes.text(LOOKED_AT[0], done.goals.sensitivity, " asked", fontsize=7, color=BEFORE, va="bottom")
    axes.set(xlim=LOOKED_AT, ylim=(0.0, max(2.0, 1.2 * done.goals.sensitivity)))
    _dressed(axes, "frequency (Hz)")


def _dressed(axes: Axes, label: str) -> None:
    axes.set_axis_on()
    axes.set_xlabel(label, fontsize=8)
    axes.tick_params(labelsize=8)


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
