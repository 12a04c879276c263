"""A robot in the hand as a picture: impedance, power, and what it can render."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap

from twin.studies.analyse.linear.hand import AXES, power_share
from twin.studies.analyse.map import SHADES, UNSTABLE
from twin.studies.analyse.passivity import Passivity
from twin.studies.analyse.text import point_name
from twin.studies.analyse.z_width import Width
from twin.studies.figure import BLUE, GREEN, GREY, INK, LIGHT_IS_GOOD, ORANGE, picture

PASSIVITY_COLORS = dict(zip(AXES, (BLUE, ORANGE, GREEN), strict=True))
PASSIVITY_LEVELS = (-1.0, -0.3, -0.1, 0.0, 1.0)


def draw_passivity(done: Passivity, path: Path) -> None:
    """Write the picture to `path` (PNG): the last point in air and the first pressing, and the map if there is one."""
    air = [point for point in done.points if not point.point.in_contact]
    pressing = [point for point in done.points if point.point.in_contact]
    shown = [*air[-1:], *pressing[:1]]
    title = f"{done.experiment.name} in the hand"
    with picture(path, 5.2 * (len(shown) + (done.width is not None)), 7.0, title) as figure:
        panels = figure.subplots(2, len(shown) + (done.width is not None), squeeze=False)
        for (upper, lower), point in zip(panels.T, shown, strict=False):
            omega = 2.0 * np.pi * point.frequency
            for i, axis in enumerate(AXES):
                Y = point.admittance[:, i, i]
                upper.loglog(point.frequency, omega / np.abs(Y), color=PASSIVITY_COLORS[axis], lw=1.3, label=axis)
                share = power_share(Y[:, None, None])
                lower.semilogx(point.frequency, share, color=PASSIVITY_COLORS[axis], lw=1.3, label=axis)
                upper.axhline(point.springs[i], color=PASSIVITY_COLORS[axis], lw=0.8, ls=":")
            lower.semilogx(point.frequency, power_share(point.admittance), color=INK, lw=1.0, ls="--", label="all")
            upper.set(title=point_name(point.point), ylabel="N per m; dotted: the springs", ylim=(30.0, 1e6))
            lower.axhline(0.0, color=GREY, lw=0.8)
            lower.set(xlabel="frequency (Hz)", ylabel="share of the power that it takes", ylim=(-1.05, 1.05))
            lower.legend(fontsize=9, title="below 0 it feeds a swing")
        if done.width is not None:
            panels[1, -1].set_axis_off()
            _draw_width(panels[0, -1], done.width)


def _draw_width(axes: Axes, width: Width) -> None:
    axes.set_facecolor(UNSTABLE)
    shades, norm = ListedColormap([SHADES[0], SHADES[1], SHADES[2], SHADES[4]]), BoundaryNorm(PASSIVITY_LEVELS, 4)
    drawn = axes.pcolormesh(width.stiffness, width.damping, width.least, cmap=shades, norm=norm, shading="nearest")
    axes.axvline(width.spring, color=INK, lw=1.2, ls=":")
    axes.annotate("springs", (width.spring, width.damping[0]), (3, 4), textcoords="offset points", fontsize=9)
    if width.largest[0]:
        axes.plot(*width.largest[1:], "o", color=INK, mfc="white", ms=7)
    axes.set(xscale="log", yscale="log", title="rendered along z; red: unstable in the air")
    axes.set(xlabel="virtual stiffness (N/m)", ylabel="virtual damping (N s/m)")
    assert axes.figure is not None
    label = f"least share of power; from 0 on passive {LIGHT_IS_GOOD}"
    axes.figure.colorbar(drawn, ax=axes, label=label, location="bottom", ticks=PASSIVITY_LEVELS[1:4])
