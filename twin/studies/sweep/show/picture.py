"""A sweep as a heat map: one metric over two parameters, failures marked."""

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize, to_rgba
from matplotlib.patches import Rectangle
from matplotlib.ticker import LogLocator, NullFormatter
from numpy.typing import NDArray

from twin.studies.figure import INK, LESS_IS_BETTER, LIGHT_IS_GOOD, MAP, VERMILION, picture
from twin.studies.sweep.columns import Numbers
from twin.studies.sweep.folder import KeptRows
from twin.studies.sweep.show.crowd import visible
from twin.studies.sweep.show.words import short
from twin.studies.sweep.statistics.ranking import claims_in, drives_in, of_drive, parameter, value

FAILED = VERMILION
MOST_NUMBERS = 2_500
"""Cells of a grid with a number in each; of more, in none of which one could be read, only the colours are drawn."""
FEW_LEVELS = 10
"""Named along an axis of so many cells."""
FAR = 3.0
"""Interquartile ranges beyond the quartiles from which a value is far out (Tukey 1977, "outer fences")."""


def draw_sweep(kept: KeptRows, axes: tuple[str, str], metric: str, path: Path) -> None:
    """Write the map of `metric` over `axes` to `path` (PNG), a panel per drive.

    Cells of a grid show the best run at that point over all other parameters; draws of a sample are dots. An orange
    cross is a run that has no number.
    """
    columns, drives = kept.columns, drives_in(kept.columns)
    x, y = (parameter(columns, label) for label in axes)
    numbers = value(columns, metric)
    on_map = ~(np.isnan(x) | np.isnan(y))
    values = numbers[on_map & ~np.isnan(numbers)]
    across = min(3, len(drives))
    lines = -(-len(drives) // across)
    with picture(path, 2.2 + 4.0 * across, 1.4 + 3.4 * lines, look=MAP) as figure:
        panels = figure.subplots(lines, across, squeeze=False, sharex=True, sharey=True).ravel()
        low, high, remark = shown_range(values)
        shade = ScalarMappable(Normalize(low, high), LESS_IS_BETTER)
        for panel, drive in zip(panels, drives, strict=False):
            mine = on_map & of_drive(columns, drive)
            _draw_panel(panel, shade, x[mine], y[mine], numbers[mine])
            panel.set_title(drive or "", fontsize=10, fontweight="bold")
        for panel in panels[len(drives) :]:
            panel.set_visible(False)
        names = short(kept.labels)
        # below the axis' name, for a legend there would lie upon it
        told = [f"orange cross: no {metric}, see the row's reason"] if len(values) < on_map.sum() else []
        figure.supxlabel("\n".join([names[axes[0]], *told, *filter(None, [remark])]), fontsize=10)
        figure.supylabel(names[axes[1]], fontsize=10)
        beyond = {"max": values.max(initial=low) > high, "min": values.min(initial=high) < low}
        extend = "both" if all(beyond.values()) else next((end for end, is_so in beyond.items() if is_so), "neither")
        # of what a claim measures, less need not be better
        label = f"{metric} {'(light is less)' if claims_in(columns) else LIGHT_IS_GOOD}"
        figure.colorbar(shade, ax=panels.tolist(), label=label, shrink=0.8, pad=0.02, extend=extend)
        figure.suptitle(f"{kept.name}: {metric}, {len(columns)} of {kept.runs} runs", x=0.01, ha="left", fontsize=11)


def shown_range(values: Numbers) -> tuple[float, float, str]:
    """(low, high, remark) of the colours: without what is far out, which would leave one colour to all others.

    The remark says how many values the ends of the colours stand for; "" if the colours span all.
    """
    if not len(values):
        return 0.0, 1.0, ""
    first, third = np.quantile(values, [0.25, 0.75])
    reach = FAR * (third - first)
    inside = values[(first - reach <= values) & (values <= third + reach)]
    least, most = float(values.min()), float(values.max())
    outside = len(values) - len(inside)
    if not outside or reach == 0.0:
        return least, most, ""
    low, high = float(inside.min()), float(inside.max())
    told = (
        f"{outside} of {len(values)} are far out, {least:.3g} to {most:.3g} in all: coloured as {low:.3g} or {high:.3g}"
    )
    return low, high, told


def _draw_panel(panel: Axes, shade: ScalarMappable, x: Numbers, y: Numbers, numbers: Numbers) -> None:
    if levels := _levels(x, y):
        at_x, at_y = levels
        i, j = np.searchsorted(at_x, x), np.searchsorted(at_y, y)
        best = np.full((len(at_x), len(at_y)), np.nan)
        np.fmin.at(best, (i, j), numbers)
        _draw_grid(panel, shade, levels, best, np.unique(i * len(at_y) + j))
        return
    # several octaves, all positive: a ratio says more than a difference
    octaves = [len(x) > 0 and along.min() > 0.0 and along.max() / along.min() >= 4.0 for along in (x, y)]
    on_paper = [np.log(along) if is_so else along for along, is_so in zip((x, y), octaves, strict=True)]
    good, bad = (np.flatnonzero(some) for some in (np.isfinite(numbers), ~np.isfinite(numbers)))
    good, bad = (some[visible(on_paper[0][some], on_paper[1][some], 1)] for some in (good, bad))
    panel.scatter(x[good], y[good], c=shade.to_rgba(numbers[good]), s=42, ec=INK, lw=0.5)
    panel.scatter(x[bad], y[bad], marker="x", color=FAILED, s=42, lw=2)
    for letter, axis, is_so in zip("xy", (panel.xaxis, panel.yaxis), octaves, strict=True):
        if is_so:
            panel.set(**{f"{letter}scale": "log"})
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(lambda number, position: f"{number:g}")
            axis.set_minor_formatter(NullFormatter())
    panel.tick_params(labelsize=8)
    panel.grid()


def _levels(x: Numbers, y: Numbers) -> tuple[Numbers, Numbers] | None:
    """Each number that there is of either, in order, where the dots are those of a grid."""
    # of a sample the first dots tell, and to sort a million takes long
    few = math.isqrt(len(x)) + 1
    if len(np.unique(x[:few])) * len(np.unique(y[:few])) > len(x):
        return None
    at_x, at_y = np.unique(x), np.unique(y)
    return (at_x, at_y) if 0 < len(at_x) * len(at_y) <= len(x) else None


def _draw_grid(
    panel: Axes, shade: ScalarMappable, levels: Sequence[Numbers], best: Numbers, cells: NDArray[np.int64]
) -> None:
    """The best number of each of the `cells`, by position in the table `best`, that some run is in."""
    many = len(cells) > MOST_NUMBERS
    if many:
        colours = shade.to_rgba(best)
        failed = cells[np.isnan(best.ravel()[cells])]
        colours.reshape(-1, 4)[failed] = to_rgba(FAILED)
        panel.imshow(colours.swapaxes(0, 1), origin="lower", aspect="auto", interpolation="nearest")
    else:
        for cell in cells.tolist():
            i, j = divmod(cell, best.shape[1])
            _draw_cell(panel, shade, i, j, best[i, j])
    for axis, level in zip((panel.xaxis, panel.yaxis), levels, strict=True):
        named = np.arange(0, len(level), -(-len(level) // FEW_LEVELS) if many else 1)
        axis.set_ticks(named, [f"{number:.4g}" for number in level[named]])
    panel.tick_params(length=0, labelsize=8)
    panel.set(xlim=(-0.5, best.shape[0] - 0.5), ylim=(-0.5, best.shape[1] - 0.5))


def _draw_cell(panel: Axes, shade: ScalarMappable, i: int, j: int, best: float) -> None:
    if np.isnan(best):
        panel.add_patch(Rectangle((i - 0.5, j - 0.5), 1, 1, fc="#f0f0f0", ec="white"))
        panel.plot(i, j, marker="x", color=FAILED, ms=9, mew=2)
        return
    r, g, b, _ = color = shade.to_rgba(best)  # type: ignore[arg-type]
    panel.add_patch(Rectangle((i - 0.5, j - 0.5), 1, 1, fc=color, ec="white"))
    ink = INK if 0.299 * r + 0.587 * g + 0.114 * b > 0.5 else "white"
    panel.text(i, j, f"{best:.3g}", ha="center", va="center", color=ink, fontsize=8)
