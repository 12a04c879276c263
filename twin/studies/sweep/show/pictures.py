"""The pictures of a sweep."""

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

from twin.studies.figure import (
    BARE_STYLE,
    BLUE,
    GREEN,
    INK,
    LESS_IS_BETTER,
    LIGHT_IS_GOOD,
    MAP_STYLE,
    ORANGE,
    PINK,
    SKY,
    VERMILION,
    picture,
)
from twin.studies.result import count_text
from twin.studies.sweep.columns import Columns, Numbers, Positions
from twin.studies.sweep.show.parts import SweepQuery, axes_of, short_names
from twin.studies.sweep.statistics.ranking import (
    Bands,
    bands,
    claims_in,
    drive_mask,
    drives_in,
    metric_spread,
    metrics_in,
    parameter,
    pareto_front,
    ranked_rows,
    value,
)
from twin.studies.sweep.stored import SweepRows

MAX_DOTS = 50_000
DRIVE_COLORS = (BLUE, VERMILION, GREEN, PINK, ORANGE, SKY, "#000000")
DRIVE_MARKERS = "osD^vP*X"
MAX_STACKED_DOTS = 4
"""Maximum number of overlapping dots drawn in a crowd; deeper dots are invisible."""
FRONT_CELLS = 1000
"""Number of cells along each axis for a crowded front, which is a line; each is smaller than a pixel."""
FAILED_COLOR = VERMILION
MAX_NUMBERED_CELLS = 2_500
"""Maximum number of grid cells labelled with a number; in more cells the numbers would be unreadable."""
MAX_NAMED_LEVELS = 10
"""Maximum number of levels named along an axis without cell labels."""
FENCE_FACTOR = 3.0
"""Outliers are farther from the quartiles, in interquartile ranges (Tukey 1977, "outer fences")."""
PANEL_COLUMNS = 3
BAND_PANELS = (
    ("A", "z", "z position, estimated (mm)", 1e3),
    ("B", "F_z", "F_z, pressing, estimated (N)", 1.0),
    ("C", "F_x", "F_x, estimated (N)", 1.0),
    ("D", "F_y", "F_y, estimated (N)", 1.0),
    ("E", "true_z", "z position, true, close up (mm)", 1e3),
    ("F", "true_F_z", "F_z, pressing, true (N)", 1.0),
)
"""Panels of the bands: letter, signal, axis label, scale."""
SETTLED_TIME = 8.0
"""Time (s) after which the height changes so little that panel E magnifies it."""
HEIGHT_MARGIN = 0.1
"""Margin above and below the height in panel E (mm)."""


def visible_dots(x: Numbers, y: Numbers, most: int, cells: int = 150) -> Positions:
    """Return the positions of the dots to draw in a scatter plot, leaving out dots hidden beneath others.

    In a crowd these are the last `most` of each cell, which are on top. Coordinates have any unit; with 150 `cells`
    along each axis a cell is smaller than a dot.
    """
    if len(x) <= MAX_DOTS:
        return np.arange(len(x))
    cell = _cells(x, cells) * (cells + 1) + _cells(y, cells)
    # Small integer types sort much faster.
    cell = cell.astype(np.min_scalar_type((cells + 1) ** 2))
    order = np.argsort(cell, kind="stable")
    behind = np.searchsorted(cell[order], cell[order], side="right") - np.arange(len(x))
    return np.sort(order[behind <= most])


def _cells(along: Numbers, cells: int) -> NDArray[np.int64]:
    span = np.ptp(along) or 1.0
    return ((along - along.min()) / span * cells).astype(np.int64)


def draw_front(sweep: SweepRows, asked: SweepQuery, path: Path) -> None:
    with picture(path, 7.5, 4.8) as figure:
        axes = figure.subplots()
        columns = sweep.columns
        ranked = ranked_rows(columns, asked.by)
        for number, drive in enumerate(drives_in(columns)):
            mine = ranked[drive_mask(columns, drive)[ranked]]
            x, y = _points(columns, mine, asked)
            drawn = visible_dots(x, y, MAX_STACKED_DOTS)
            axes.scatter(
                x[drawn], y[drawn], s=26, color=DRIVE_COLORS[number % len(DRIVE_COLORS)],
                marker=DRIVE_MARKERS[number % len(DRIVE_MARKERS)],
                alpha=0.75, lw=0, label=f"{drive or 'runs'} ({len(mine)})",
            )  # fmt: skip
        x, y = _points(columns, pareto_front(columns, asked.by, asked.against), asked)
        drawn = visible_dots(x, y, 1, FRONT_CELLS)
        x, y = x[drawn], y[drawn]
        axes.step(x, y, where="post", color=INK, lw=1.2, label="Pareto front")
        axes.scatter(x, y, s=70, facecolors="none", edgecolors=INK, lw=1.2)
        axes.set(xlabel=f"{asked.by} (less is better)", ylabel=f"{asked.against} (less is better)")
        axes.legend()
        absent = len(columns) - len(ranked)
        text = f"; {count_text(absent, 'run')} not shown: failed, tripped or beyond the limits" if absent else ""
        figure.suptitle(f"{sweep.name}: {len(ranked)} of {sweep.runs} runs{text}", x=0.01, ha="left", fontsize=10)


def _points(columns: Columns, rows: Positions, asked: SweepQuery) -> tuple[Numbers, Numbers]:
    return value(columns, asked.by)[rows], value(columns, asked.against)[rows]


def draw_sweep(sweep: SweepRows, axes: tuple[str, str], metric: str, path: Path) -> None:
    """Draw the map of a metric over two varied parameters to `path` (PNG), a panel per drive.

    Cells of a grid show the best run at that point over all other parameters; sampled runs are dots. An orange cross is
    a run without that number.
    """
    columns, drives = sweep.columns, drives_in(sweep.columns)
    x, y = (parameter(columns, label) for label in axes)
    numbers = value(columns, metric)
    on_map = ~(np.isnan(x) | np.isnan(y))
    values = numbers[on_map & ~np.isnan(numbers)]
    across = min(3, len(drives))
    lines = -(-len(drives) // across)
    with picture(path, 2.2 + 4.0 * across, 1.4 + 3.4 * lines, look=MAP_STYLE) as figure:
        panels = figure.subplots(lines, across, squeeze=False, sharex=True, sharey=True).ravel()
        low, high, remark = shown_range(values)
        shade = ScalarMappable(Normalize(low, high), LESS_IS_BETTER)
        for panel, drive in zip(panels, drives, strict=False):
            mine = on_map & drive_mask(columns, drive)
            _draw_panel(panel, shade, x[mine], y[mine], numbers[mine])
            panel.set_title(drive or "", fontsize=10, fontweight="bold")
        for panel in panels[len(drives) :]:
            panel.set_visible(False)
        names = short_names(sweep.labels)
        # Below the axis label, since a legend there would overlap it.
        legend = [f"orange cross: no {metric}, see the row's reason"] if len(values) < on_map.sum() else []
        figure.supxlabel("\n".join([names[axes[0]], *legend, *filter(None, [remark])]), fontsize=10)
        figure.supylabel(names[axes[1]], fontsize=10)
        beyond = {"max": values.max(initial=low) > high, "min": values.min(initial=high) < low}
        extend = "both" if all(beyond.values()) else next((end for end, is_so in beyond.items() if is_so), "neither")
        # For the quantity measured by a claim, less need not be better.
        label = f"{metric} {'(light is less)' if claims_in(columns) else LIGHT_IS_GOOD}"
        figure.colorbar(shade, ax=panels.tolist(), label=label, shrink=0.8, pad=0.02, extend=extend)
        figure.suptitle(f"{sweep.name}: {metric}, {len(columns)} of {sweep.runs} runs", x=0.01, ha="left", fontsize=11)


def shown_range(values: Numbers) -> tuple[float, float, str]:
    """Return (low, high, remark) of a color scale without outliers; the remark counts them, "" without any."""
    if not len(values):
        return 0.0, 1.0, ""
    first, third = np.quantile(values, [0.25, 0.75])
    reach = FENCE_FACTOR * (third - first)
    inside = values[(first - reach <= values) & (values <= third + reach)]
    least, most = float(values.min()), float(values.max())
    outside = len(values) - len(inside)
    if not outside or reach == 0.0:
        return least, most, ""
    low, high = float(inside.min()), float(inside.max())
    far = f"{outside} of {len(values)} are far out, {least:.3g} to {most:.3g} in all"
    return low, high, f"{far}: coloured as {low:.3g} or {high:.3g}"


def _draw_panel(panel: Axes, shade: ScalarMappable, x: Numbers, y: Numbers, numbers: Numbers) -> None:
    if levels := _levels(x, y):
        at_x, at_y = levels
        i, j = np.searchsorted(at_x, x), np.searchsorted(at_y, y)
        best = np.full((len(at_x), len(at_y)), np.nan)
        np.fmin.at(best, (i, j), numbers)
        _draw_grid(panel, shade, levels, best, np.unique(i * len(at_y) + j))
        return
    # Positive values over several octaves are compared by ratio, so the axis is logarithmic.
    octaves = [len(x) > 0 and along.min() > 0.0 and along.max() / along.min() >= 4.0 for along in (x, y)]
    on_paper = [np.log(along) if is_so else along for along, is_so in zip((x, y), octaves, strict=True)]
    good, bad = (np.flatnonzero(some) for some in (np.isfinite(numbers), ~np.isfinite(numbers)))
    good, bad = (some[visible_dots(on_paper[0][some], on_paper[1][some], 1)] for some in (good, bad))
    panel.scatter(x[good], y[good], c=shade.to_rgba(numbers[good]), s=42, ec=INK, lw=0.5)
    panel.scatter(x[bad], y[bad], marker="x", color=FAILED_COLOR, s=42, lw=2)
    for letter, axis, is_so in zip("xy", (panel.xaxis, panel.yaxis), octaves, strict=True):
        if is_so:
            panel.set(**{f"{letter}scale": "log"})
            axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
            axis.set_major_formatter(lambda number, position: f"{number:g}")
            axis.set_minor_formatter(NullFormatter())
    panel.tick_params(labelsize=8)
    panel.grid()


def _levels(x: Numbers, y: Numbers) -> tuple[Numbers, Numbers] | None:
    """Return the sorted distinct coordinates of a sweep's dots if they form a grid; None otherwise."""
    # The first dots suffice to recognise a sample, and sorting a million is slow.
    few = math.isqrt(len(x)) + 1
    if len(np.unique(x[:few])) * len(np.unique(y[:few])) > len(x):
        return None
    at_x, at_y = np.unique(x), np.unique(y)
    return (at_x, at_y) if 0 < len(at_x) * len(at_y) <= len(x) else None


def _draw_grid(
    panel: Axes, shade: ScalarMappable, levels: Sequence[Numbers], best: Numbers, cells: NDArray[np.int64]
) -> None:
    many = len(cells) > MAX_NUMBERED_CELLS
    if many:
        colours = shade.to_rgba(best)
        failed = cells[np.isnan(best.ravel()[cells])]
        colours.reshape(-1, 4)[failed] = to_rgba(FAILED_COLOR)
        panel.imshow(colours.swapaxes(0, 1), origin="lower", aspect="auto", interpolation="nearest")
    else:
        for cell in cells.tolist():
            i, j = divmod(cell, best.shape[1])
            _draw_cell(panel, shade, i, j, best[i, j])
    for axis, level in zip((panel.xaxis, panel.yaxis), levels, strict=True):
        named = np.arange(0, len(level), -(-len(level) // MAX_NAMED_LEVELS) if many else 1)
        axis.set_ticks(named, [f"{number:.4g}" for number in level[named]])
    panel.tick_params(length=0, labelsize=8)
    panel.set(xlim=(-0.5, best.shape[0] - 0.5), ylim=(-0.5, best.shape[1] - 0.5))


def _draw_cell(panel: Axes, shade: ScalarMappable, i: int, j: int, best: float) -> None:
    if np.isnan(best):
        panel.add_patch(Rectangle((i - 0.5, j - 0.5), 1, 1, fc="#f0f0f0", ec="white"))
        panel.plot(i, j, marker="x", color=FAILED_COLOR, ms=9, mew=2)
        return
    r, g, b, _ = color = shade.to_rgba(best)  # type: ignore[arg-type]
    panel.add_patch(Rectangle((i - 0.5, j - 0.5), 1, 1, fc=color, ec="white"))
    ink = INK if 0.299 * r + 0.587 * g + 0.114 * b > 0.5 else "white"
    panel.text(i, j, f"{best:.3g}", ha="center", va="center", color=ink, fontsize=8)


def draw_spreads(sweep: SweepRows, path: Path) -> None:
    columns = sweep.columns
    metrics, drives = metrics_in(columns), drives_in(columns)
    lines = -(-len(metrics) // PANEL_COLUMNS)
    with picture(path, 11, 0.8 + 2.3 * lines, look=BARE_STYLE) as figure:
        panels = figure.subplots(lines, PANEL_COLUMNS, squeeze=False).ravel()
        for axes, metric in zip(panels, metrics, strict=False):
            found = metric_spread(columns, metric)
            assert found is not None
            for number, drive in enumerate(drives):
                values = value(columns, metric)[drive_mask(columns, drive)] if len(drives) > 1 else found.numbers
                counts, _ = np.histogram(values[~np.isnan(values)], len(found.counts), tuple(found.edges[[0, -1]]))
                # Passing counts instead of values keeps a million runs fast.
                axes.hist(
                    found.edges[:-1], found.edges, weights=counts, color=DRIVE_COLORS[number % len(DRIVE_COLORS)],
                    histtype="stepfilled" if len(drives) == 1 else "step", lw=1.6, label=drive,
                )  # fmt: skip
            axes.axvline(found.quantiles[2], color=INK, lw=1.0, ls="--")
            axes.set(xlabel=metric + (f" ({found.missing} runs have none)" if found.missing else ""), ylabel="runs")
            axes.tick_params(labelsize=8)
        for axes in panels[len(metrics) :]:
            axes.set_visible(False)
        if len(drives) > 1:
            handles, labels = panels[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside lower center", ncols=min(5, len(drives)))
        figure.suptitle(f"{sweep.name}: {len(columns)} runs; dashed: median", x=0.01, ha="left", fontsize=10)


def draw_bands(bands: Bands, sweep: SweepRows, path: Path) -> None:
    """Draw the quantile bands (A to D as Fig. 4, force-position on top; true signals below) to `path` (PNG)."""
    # Slow to import, and few sweeps judge claims.
    from twin.studies.paper.fig4_figure import FP_BASED, FP_REFERENCE, P_BASED

    runs = (("position", P_BASED, "P-based"), ("force_position", FP_BASED, "F&P-based"))
    with picture(path, 12, 10.5) as figure:
        panels = figure.subplots(3, 2, sharex=True)
        for axes, (letter, name, label, scale) in zip(panels.ravel(), BAND_PANELS, strict=True):
            if letter == "A":
                _draw(axes, bands, "force_position.z_cmd", scale, FP_REFERENCE, "F&P-based-ref")
            for run, color, who in runs:
                _draw(axes, bands, f"{run}.{name}", scale, color, who)
            axes.set_ylabel(label)
            axes.set_title(letter, loc="left", fontweight="bold")
            axes.legend()
            axes.set_xlim(0, 20)
        for pair in ((panels[1, 0], panels[1, 1]), (panels[0, 1], panels[2, 1])):
            limits = [axes.get_ylim() for axes in pair]
            for axes in pair:
                axes.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))
        settled = bands.t >= SETTLED_TIME
        z = [1e3 * bands[f"{run}.true_z"][:, settled] for run, _, _ in runs]
        panels[2, 0].set_ylim(min(map(np.min, z)) - HEIGHT_MARGIN, max(map(np.max, z)) + HEIGHT_MARGIN)
        for axes in panels[2]:
            axes.set_xlabel("time (s)")
        figure.suptitle(
            f"{sweep.name}: {bands.runs} of {sweep.runs} runs; line: median, dark: 25 to 75 %, light: 5 to 95 %",
            x=0.01, ha="left", fontsize=11,
        )  # fmt: skip


def _draw(axes: Axes, bands: Bands, name: str, scale: float, color: str, label: str) -> None:
    least, low, median, high, most = scale * bands[name]
    axes.fill_between(bands.t, least, most, color=color, alpha=0.18, lw=0)
    axes.fill_between(bands.t, low, high, color=color, alpha=0.35, lw=0)
    axes.plot(bands.t, median, color=color, lw=1.4, label=label)


def write_pictures(sweep: SweepRows, asked: SweepQuery, x: str | None, y: str | None, folder: Path) -> dict[str, Path]:
    """Draw all pictures (heat map over x and y, default the first two) into a folder; return kind -> file."""
    files: dict[str, Path] = {}
    axes = axes_of(sweep, x, y)
    # Curves are only in the rows, not in the columns.
    found = bands(sweep.rows) if True in sweep.columns.categorical("has_curves").counts else None
    if found:
        files["bands"] = folder / "bands.png"
        draw_bands(found, sweep, files["bands"])
    # The parameters of a sweep with claims are uncertain and cannot be chosen, so a map has no best place.
    if axes and (not found or x or y):
        files["map"] = folder / "map.png"
        draw_sweep(sweep, axes, asked.by, files["map"])
    if not found and len(pareto_front(sweep.columns, asked.by, asked.against)) > 1:
        files["front"] = folder / "front.png"
        draw_front(sweep, asked, files["front"])
    if len(sweep.columns) > 1 and metrics_in(sweep.columns):
        files["metrics"] = folder / "metrics.png"
        draw_spreads(sweep, files["metrics"])
    return files
