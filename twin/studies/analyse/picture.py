"""The loops of an experiment as a picture: Bode, Nyquist, sensitivity, root loci."""

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import MultipleLocator
from numpy.typing import ArrayLike, NDArray

from twin.studies.analyse.linear.loops import closed_poles
from twin.studies.analyse.linear.margins import Margins, frequencies, loop_response
from twin.studies.analyse.stability import FORCE, POSITION, PointStability, Stability
from twin.studies.analyse.text import loop_name, point_name
from twin.studies.figure import BLUE, GREEN, GREY, INK, ORANGE, PINK, SKY, VERMILION, picture

SHOWN_GAIN = (1e-4, 1e3)
COLORS = (BLUE, ORANGE, GREEN, PINK, VERMILION, SKY)
LOCUS = np.geomspace(1e-2, 1.0, 60)
"""Gains of a root locus below the present or critical one, as a share of its largest."""
SWINGING = 0.3
"""Damping ratio below which a pole is one of the platform on its springs, which a root locus shows."""

Curve = tuple[PointStability, str]
Numbers = NDArray[np.float64]


def draw_analysis(done: Stability, path: Path) -> None:
    """Write the picture to `path` (PNG).

    Shown are the points that leave the gains of the two laws least room; an unstable one only as a root locus.
    """
    title = f"Loops of {done.experiment.name}: {'stable' if done.stable else 'UNSTABLE'}"
    with picture(path, 13, 8.5, title) as figure:
        (magnitude, nyquist, sensitivity), (phase, position, force) = figure.subplots(2, 3)
        curves = shown_loops(done)
        for color, (judged, name) in zip(COLORS, curves, strict=False):
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
        # an axis of its own: one that follows a logarithmic axis cannot go below 0
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
        _draw_locus(position, done, "position", POSITION)
        _draw_locus(force, done, "force", FORCE)
        if curves:
            figure.legend(loc="outside lower center", ncols=2, fontsize=9)


def decibels(factor: ArrayLike) -> Numbers:
    """20 log10 of a factor; of none at all the least that a double holds."""
    return 20.0 * np.log10(np.maximum(factor, np.finfo(float).tiny))


def margins_text(margins: Margins) -> str:
    """`: 22 dB, 88 deg`; "" without either."""
    found = [] if margins.gain is None else [f"{decibels(margins.gain):.0f} dB"]
    found += [] if margins.phase is None else [f"{np.degrees(margins.phase):.0f} deg"]
    return f": {', '.join(found)}" if found else ""


def _mark_margins(magnitude: Axes, phase: Axes, margins: Margins, curve: tuple[Numbers, Numbers], color: str) -> None:
    """A bar from |L| up to 1 where the phase is -180 degrees, and one from there to the phase where |L| is 1."""
    look: dict[str, Any] = {"color": color, "lw": 2.4, "alpha": 0.7, "marker": "_", "ms": 7}
    if margins.gain is not None and margins.gain_frequency is not None:
        at = margins.gain_frequency / (2.0 * np.pi)
        magnitude.plot([at, at], [1.0 / margins.gain, 1.0], **look)
    if margins.phase is not None and margins.crossover is not None:
        at, own = margins.crossover / (2.0 * np.pi), np.degrees(margins.phase)
        degrees = np.interp(at, *curve)
        # whole turns are no difference
        phase.plot([at, at], [degrees - own, degrees], **look)


def shown_loops(done: Stability) -> list[Curve]:
    """Position x, y and z of the critical point of the position law, then z and force of that of the force law."""
    curves: list[Curve] = []
    for law, names in (("position", POSITION), ("force", ("position_z", *FORCE))):
        critical = done.critical(law)
        if critical is not None and critical.stable:
            curves += [(critical, name) for name in names]
    return curves


def _draw_locus(axes: Axes, done: Stability, law: str, names: tuple[str, ...]) -> None:
    """Closed-loop poles s = ln(z) / T while all gains of a law grow from nothing to 1.5 times their limit."""
    critical = done.critical(law)
    limit = critical.limits[law] if critical else None
    if critical is None or not limit:
        axes.set_axis_off()
        return
    loops, gains = critical.linear.loops, critical.linear.gains
    for factor in (*(1.5 * limit * LOCUS), limit, 1.0):
        z = closed_poles(loops, gains | dict.fromkeys(names, factor))
        s = np.log(z[np.abs(z) > 1e-6].astype(complex)) / loops.dt
        mark = {1.0: ("o", 28, INK), limit: ("x", 40, VERMILION)}.get(factor, (".", 5, BLUE))
        axes.scatter(s.real, s.imag / (2.0 * np.pi), marker=mark[0], s=mark[1], color=mark[2], linewidths=1.2)
    top = 2.0 * max((pole.omega for pole in critical.poles if pole.zeta < SWINGING), default=50.0)
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
