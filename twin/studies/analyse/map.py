"""Damping of the closed loops over contact stiffness and gains, as a picture."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap

from twin.studies.analyse.stability import Stability, StabilityMap
from twin.studies.analyse.text import point_name
from twin.studies.figure import INK, LIGHT_IS_GOOD, MAP, VERMILION, picture

LEVELS = (-1.0, 0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 1.0)
UNSTABLE, NO_POINT = VERMILION, "#d9d9d9"
SHADES = ("#2a788e", "#5aa6a9", "#9accc4", "#cfe6df", "#f4f0dc", "#fdf9cf")
"""From hardly damped to well damped: light is good, as in every map."""


def draw_stability_maps(done: Stability, path: Path) -> None:
    """Write the picture to `path` (PNG); `done` has at least one map."""
    title = f"{done.experiment.name}: {point_name(done.maps[0].at.point)}, on surfaces of other stiffness"
    with picture(path, 6.3 * len(done.maps) + 1.0, 5.2, title, look=MAP) as figure:
        shades, norm = ListedColormap([UNSTABLE, *SHADES]), BoundaryNorm(LEVELS, 1 + len(SHADES))
        panels = figure.subplots(1, len(done.maps), squeeze=False)[0]
        for axes, chart in zip(panels, done.maps, strict=True):
            axes.set_facecolor(NO_POINT)
            gain = _gain(done, chart)
            drawn = axes.pcolormesh(chart.stiffness, gain, chart.zeta, cmap=shades, norm=norm, shading="nearest")
            _mark(axes, done, chart)
        label = f"smallest damping ratio of a closed-loop pole {LIGHT_IS_GOOD}"
        bar = figure.colorbar(drawn, ax=list(panels), ticks=LEVELS, label=label)
        bar.ax.set_yticklabels(["unstable", *(f"{level:g}" for level in LEVELS[1:])])


def _mark(axes: Axes, done: Stability, chart: StabilityMap) -> None:
    gain, K = _gain(done, chart), chart.at.point.parameters.K
    axes.contour(chart.stiffness, gain, chart.zeta, levels=[0.0], colors=INK, linewidths=1.2)
    axes.plot(K, np.interp(1.0, chart.factors, gain), "o", color=INK, mfc="white", ms=8)
    axes.annotate("as it is", (K, np.interp(1.0, chart.factors, gain)), (8, 4), textcoords="offset points")
    axes.set(xscale="log", yscale="log", xlabel="contact stiffness (N/m)", ylabel=_gain_label(done, chart))


def _gain_label(done: Stability, chart: StabilityMap) -> str:
    force = done.experiment.controller.force
    if not _kp(done, chart):
        return f"{chart.law} gains, times what is set"
    return f"force kp (mm/N){', ki with it' if force.ki else ''}" if chart.law == "force" else "position kp (1/s)"


def _kp(done: Stability, chart: StabilityMap) -> float:
    c = done.experiment.controller
    return 1e3 * c.force.kp if chart.law == "force" else c.position.kp


def _gain(done: Stability, chart: StabilityMap) -> np.ndarray:
    return chart.factors * (_kp(done, chart) or 1.0)
