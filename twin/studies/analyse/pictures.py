"""Pictures of the linear analysis: loops, stability maps, and the impedance felt by a hand."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.ticker import MultipleLocator

from twin.studies.analyse import passivity, rendering, stability
from twin.studies.analyse.linear.hand import AXES, power_share
from twin.studies.analyse.linear.loops import Matrix, closed_poles
from twin.studies.analyse.linear.margins import DiskMargin, Margins, frequencies, loop_response
from twin.studies.analyse.text import Numbers, decibels, loop_name, margins_text, point_name
from twin.studies.figure import (
    BLUE,
    GREEN,
    GREY,
    INK,
    LIGHT_IS_GOOD,
    MAP_STYLE,
    ORANGE,
    PINK,
    SKY,
    VERMILION,
    Axes,
    picture,
)

SHOWN_GAIN = (1e-4, 1e3)
CURVE_COLORS = (BLUE, ORANGE, GREEN, PINK, VERMILION, SKY)
LOCUS_GAINS = np.geomspace(1e-2, 1.0, 60)
"""Gains of a root locus below the current or critical one, as a share of its largest."""
MAX_SWING_DAMPING = 0.3
"""Damping ratio below which a root locus counts a pole as the platform's swing on its springs."""
Curve = tuple[stability.PointStability, str]
DISK_COLORS = {"laws": BLUE, "motors": ORANGE, "both": GREEN}
MAX_DECIBELS = 24.0
"""Largest gain drawn (dB)."""
DAMPING_LEVELS = (-1.0, 0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 1.0)
UNSTABLE_COLOR, NO_POINT_COLOR = VERMILION, "#d9d9d9"
DAMPING_SHADES = ("#2a788e", "#5aa6a9", "#9accc4", "#cfe6df", "#f4f0dc", "#fdf9cf")
"""Colours from weakly damped to well damped: light is good, as in every map."""
PASSIVITY_COLORS = dict(zip(AXES, (BLUE, ORANGE, GREEN), strict=True))
PASSIVITY_LEVELS = (-1.0, -0.3, -0.1, 0.0, 1.0)


def draw_analysis(done: stability.Stability, path: Path) -> None:
    """Draw frequency responses and margins of the stable, root loci of all shown points to `path` (PNG)."""
    title = f"Loops of {done.experiment.name}: {'stable' if done.stable else 'UNSTABLE'}"
    with picture(path, 13, 8.5, title) as figure:
        (magnitude, nyquist, sensitivity), (phase, position, force) = figure.subplots(2, 3)
        curves = shown_loops(done)
        for color, (judged, name) in zip(CURVE_COLORS, curves, strict=False):
            loops = judged.linear.loops
            omega = frequencies(loops.dt)
            L = loop_response(loops, judged.linear.gains, name, omega)
            label = f"{loop_name(name)}, {point_name(judged.linear.point)}{margins_text(judged.margins[name])}"
            hertz = omega / (2.0 * np.pi)
            magnitude.loglog(hertz, np.abs(L), color=color, lw=1.2, label=label)
            degrees = np.unwrap(np.angle(L, deg=True), period=360.0)
            phase.semilogx(hertz, degrees, color=color, lw=1.2)
            _mark_margins(magnitude, phase, judged.margins[name], (hertz, degrees), color)
            nyquist.plot(L.real, L.imag, color=color, lw=1.2)
            sensitivity.loglog(hertz, np.abs(1.0 / (1.0 + L)), color=color, lw=1.2)
            sensitivity.loglog(hertz, np.abs(L / (1.0 + L)), color=color, lw=1.0, ls=":")
        magnitude.set(title="Loop gain |L|, bars: gain margins", xlabel="frequency (Hz)", ylabel="factor")
        magnitude.set_ylim(*SHOWN_GAIN)
        # an independent axis: one derived from a logarithmic axis cannot go below 0
        in_dB = magnitude.twinx()
        in_dB.set(ylabel="dB", ylim=tuple(decibels(SHOWN_GAIN)))
        in_dB.yaxis.set_major_locator(MultipleLocator(20.0))
        in_dB.grid(False)
        magnitude.axhline(1.0, color=GREY, lw=0.8)
        phase.set(title="Phase of L, bars: phase margins", xlabel="frequency (Hz)", ylabel="degrees")
        phase.axhline(-180.0, color=GREY, lw=0.8)
        phase.set_ylim(-450.0, 20.0)
        sensitivity.set(title="|1/(1+L)|, dotted |L/(1+L)|", xlabel="frequency (Hz)")
        sensitivity.set_ylim(1e-2, 5.0)
        _dress_nyquist(nyquist)
        _draw_locus(position, done, "position", stability.POSITION_LOOPS)
        _draw_locus(force, done, "force", stability.FORCE_LOOPS)
        if curves:
            figure.legend(loc="outside lower center", ncols=2, fontsize=9)


def _mark_margins(magnitude: Axes, phase: Axes, margins: Margins, curve: tuple[Numbers, Numbers], color: str) -> None:
    look: dict[str, Any] = {"color": color, "lw": 2.4, "alpha": 0.7, "marker": "_", "ms": 7}
    if margins.gain is not None and margins.gain_frequency is not None:
        at = margins.gain_frequency / (2.0 * np.pi)
        magnitude.plot([at, at], [1.0 / margins.gain, 1.0], **look)
    if margins.phase is not None and margins.crossover is not None:
        at, own = margins.crossover / (2.0 * np.pi), np.degrees(margins.phase)
        degrees = np.interp(at, *curve)
        # the margin is invariant under whole turns
        phase.plot([at, at], [degrees - own, degrees], **look)


def shown_loops(done: stability.Stability) -> list[Curve]:
    """Select position x, y, z at the position law's lowest gain limit, then z and force at the force law's."""
    curves: list[Curve] = []
    for law, names in (("position", stability.POSITION_LOOPS), ("force", ("position_z", *stability.FORCE_LOOPS))):
        critical = done.critical(law)
        if critical is not None and critical.stable:
            curves += [(critical, name) for name in names]
    return curves


def _draw_locus(axes: Axes, done: stability.Stability, law: str, names: tuple[str, ...]) -> None:
    """Draw the root locus of a control law, s = ln(z) / T, for gains from 0 to 1.5 times their limit."""
    critical = done.critical(law)
    limit = critical.limits[law] if critical else None
    if critical is None or not limit:
        axes.set_axis_off()
        return
    loops, gains = critical.linear.loops, critical.linear.gains
    for factor in (*(1.5 * limit * LOCUS_GAINS), limit, 1.0):
        z = closed_poles(loops, gains | dict.fromkeys(names, factor))
        s = np.log(z[np.abs(z) > 1e-6].astype(complex)) / loops.dt
        mark = {1.0: ("o", 28, INK), limit: ("x", 40, VERMILION)}.get(factor, (".", 5, BLUE))
        axes.scatter(s.real, s.imag / (2.0 * np.pi), marker=mark[0], s=mark[1], color=mark[2], linewidths=1.2)
    top = 2.0 * max((pole.omega for pole in critical.poles if pole.zeta < MAX_SWING_DAMPING), default=50.0)
    axes.set(xlim=(-0.6 * top, 0.2 * top), ylim=(0.0, top / (2.0 * np.pi)))
    axes.axvspan(0.0, 0.2 * top, color=VERMILION, alpha=0.08, lw=0)
    axes.axvline(0.0, color=GREY, lw=0.8)
    title = f"Root locus, {law} gains\no now, x at the limit of {limit:.3g} times"
    axes.set(title=title, xlabel="real part of s (1/s)", ylabel="imaginary part / 2 pi (Hz)")


def _dress_nyquist(axes: Axes) -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 200)
    axes.plot(np.cos(turn), np.sin(turn), color=GREY, lw=0.8)
    axes.plot(-1.0 + 0.5 * np.cos(turn), 0.5 * np.sin(turn), color=GREY, lw=0.8, ls=":")
    axes.plot(-1.0, 0.0, "+", color=INK, ms=10)
    axes.set(xlim=(-2.0, 1.0), ylim=(-1.5, 1.5), aspect="equal")
    axes.set(title="Nyquist; inside the dotted circle M_s > 2", xlabel="Re L", ylabel="Im L")


def draw_disks(done: stability.Stability, path: Path) -> None:
    """Draw the disk margins to `path` (PNG), at the stable points with the smallest disk, in air and pressing."""
    shown = [point for in_contact in (False, True) if (point := _tightest(done, in_contact)) is not None]
    with picture(path, 11, 4.6, f"All loops of {done.experiment.name} off at once") as figure:
        for axes, point in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
            for where, disk in point.disks.items():
                gain, phase = outline(disk)
                axes.fill(gain, phase, color=DISK_COLORS[where], alpha=0.15, lw=0)
                axes.plot(gain, phase, color=DISK_COLORS[where], lw=1.3, label=f"{where}: {disk.alpha:.2f}")
            axes.set(xlim=(-MAX_DECIBELS, MAX_DECIBELS), ylim=(-100.0, 135.0), title=point_name(point.linear.point))
            axes.set(xlabel="gain of each loop, times (dB)", ylabel="phase of each loop, more by (degrees)")
            axes.legend(loc="upper center", ncols=3, title="inside, each as it likes", fontsize=9)


def outline(disk: DiskMargin) -> tuple[Matrix, Matrix]:
    """Return gain (dB) and phase (degrees) along the edge of a disk margin."""
    delta = disk.alpha * np.exp(1j * np.linspace(1e-6, 2.0 * np.pi - 1e-6, 721))
    f = (1.0 + 0.5 * delta) / (1.0 - 0.5 * delta)
    return 20.0 * np.log10(np.abs(f)), np.angle(f, deg=True)


def _tightest(done: stability.Stability, in_contact: bool) -> stability.PointStability | None:
    there = [point for point in done.points if point.disks and point.linear.point.in_contact == in_contact]
    return min(there, key=lambda point: min(disk.alpha for disk in point.disks.values()), default=None)


def draw_stability_maps(done: stability.Stability, path: Path) -> None:
    """Draw the stability maps of an analysis, which has at least one, to `path` (PNG)."""
    title = f"{done.experiment.name}: {point_name(done.maps[0].at.point)}, on surfaces of other stiffness"
    with picture(path, 6.3 * len(done.maps) + 1.0, 5.2, title, look=MAP_STYLE) as figure:
        shades = ListedColormap([UNSTABLE_COLOR, *DAMPING_SHADES])
        norm = BoundaryNorm(DAMPING_LEVELS, 1 + len(DAMPING_SHADES))
        panels = figure.subplots(1, len(done.maps), squeeze=False)[0]
        for axes, chart in zip(panels, done.maps, strict=True):
            axes.set_facecolor(NO_POINT_COLOR)
            gain = _gain(done, chart)
            drawn = axes.pcolormesh(chart.stiffness, gain, chart.zeta, cmap=shades, norm=norm, shading="nearest")
            _mark(axes, done, chart)
        label = f"smallest damping ratio of a closed-loop pole {LIGHT_IS_GOOD}"
        bar = figure.colorbar(drawn, ax=list(panels), ticks=DAMPING_LEVELS, label=label)
        bar.ax.set_yticklabels(["unstable", *(f"{level:g}" for level in DAMPING_LEVELS[1:])])


def _mark(axes: Axes, done: stability.Stability, chart: stability.StabilityMap) -> None:
    gain, K = _gain(done, chart), chart.at.point.parameters.K
    axes.contour(chart.stiffness, gain, chart.zeta, levels=[0.0], colors=INK, linewidths=1.2)
    axes.plot(K, np.interp(1.0, chart.factors, gain), "o", color=INK, mfc="white", ms=8)
    axes.annotate("as it is", (K, np.interp(1.0, chart.factors, gain)), (8, 4), textcoords="offset points")
    axes.set(xscale="log", yscale="log", xlabel="contact stiffness (N/m)", ylabel=_gain_label(done, chart))


def _gain_label(done: stability.Stability, chart: stability.StabilityMap) -> str:
    force = done.experiment.controller.force
    if not _kp(done, chart):
        return f"{chart.law} gains, times what is set"
    return f"force kp (mm/N){', ki with it' if force.ki else ''}" if chart.law == "force" else "position kp (1/s)"


def _kp(done: stability.Stability, chart: stability.StabilityMap) -> float:
    c = done.experiment.controller
    return 1e3 * c.force.kp if chart.law == "force" else c.position.kp


def _gain(done: stability.Stability, chart: stability.StabilityMap) -> np.ndarray:
    return chart.factors * (_kp(done, chart) or 1.0)


def draw_passivity(done: passivity.Passivity, path: Path) -> None:
    air = [point for point in done.points if not point.point.in_contact]
    pressing = [point for point in done.points if point.point.in_contact]
    shown = [*air[-1:], *pressing[:1]]
    columns = len(shown) + (done.width is not None)
    with picture(path, 5.2 * columns, 7.0, f"{done.experiment.name} in the hand") as figure:
        panels = figure.subplots(2, columns, squeeze=False)
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


def _draw_width(axes: Axes, width: rendering.ZWidth) -> None:
    axes.set_facecolor(UNSTABLE_COLOR)
    shades, norm = ListedColormap([*DAMPING_SHADES[:3], DAMPING_SHADES[4]]), BoundaryNorm(PASSIVITY_LEVELS, 4)
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
