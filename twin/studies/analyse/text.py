"""The loops of an experiment as text of at most 80 columns and as pictures, and the impedance felt by a hand."""

import math
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.ticker import MultipleLocator
from numpy.typing import ArrayLike, NDArray

from twin.kernel.serialise import to_dict
from twin.studies.analyse import passivity, stability
from twin.studies.analyse.linear.hand import AXES, power_share
from twin.studies.analyse.linear.loops import Matrix, closed_poles
from twin.studies.analyse.linear.margins import LARGEST_GAIN, DiskMargin, Margins, Pole, frequencies, loop_response
from twin.studies.analyse.operating_point import OperatingPoint
from twin.studies.figure import BLUE, GREEN, GREY, INK, LIGHT_IS_GOOD, MAP, ORANGE, PINK, SKY, VERMILION, Axes, picture
from twin.studies.result import TIE, Block, Column, Note, Result, Row, Table, counted

SHOWN_GAIN = (1e-4, 1e3)
COLORS = (BLUE, ORANGE, GREEN, PINK, VERMILION, SKY)
LOCUS = np.geomspace(1e-2, 1.0, 60)
"""Gains of a root locus below the present or critical one, as a share of its largest."""
SWINGING = 0.3
"""Damping ratio below which a pole is one of the platform on its springs, which a root locus shows."""

Curve = tuple[stability.PointStability, str]
Numbers = NDArray[np.float64]


def draw_analysis(done: stability.Stability, path: Path) -> None:
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
        _draw_locus(position, done, "position", stability.POSITION)
        _draw_locus(force, done, "force", stability.FORCE)
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


def shown_loops(done: stability.Stability) -> list[Curve]:
    """Position x, y and z of the critical point of the position law, then z and force of that of the force law."""
    curves: list[Curve] = []
    for law, names in (("position", stability.POSITION), ("force", ("position_z", *stability.FORCE))):
        critical = done.critical(law)
        if critical is not None and critical.stable:
            curves += [(critical, name) for name in names]
    return curves


def _draw_locus(axes: Axes, done: stability.Stability, law: str, names: tuple[str, ...]) -> None:
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


DISK_COLORS = {"laws": BLUE, "motors": ORANGE, "both": GREEN}
WIDEST = 24.0
"""dB that are drawn."""


def draw_disks(done: stability.Stability, path: Path) -> None:
    """Write the picture to `path` (PNG): the stable point with the smallest disk, in air and pressing."""
    shown = [point for in_contact in (False, True) if (point := _tightest(done, in_contact)) is not None]
    with picture(path, 11, 4.6, f"All loops of {done.experiment.name} off at once") as figure:
        for axes, point in zip(figure.subplots(1, len(shown), squeeze=False)[0], shown, strict=True):
            for where, disk in point.disks.items():
                gain, phase = outline(disk)
                axes.fill(gain, phase, color=DISK_COLORS[where], alpha=0.15, lw=0)
                axes.plot(gain, phase, color=DISK_COLORS[where], lw=1.3, label=f"{where}: {disk.alpha:.2f}")
            axes.set(xlim=(-WIDEST, WIDEST), ylim=(-100.0, 135.0), title=point_name(point.linear.point))
            axes.set(xlabel="gain of each loop, times (dB)", ylabel="phase of each loop, more by (degrees)")
            axes.legend(loc="upper center", ncols=3, title="inside, each as it likes", fontsize=9)


def outline(disk: DiskMargin) -> tuple[Matrix, Matrix]:
    """Gain (dB) and phase (degrees) along the edge of the disk."""
    delta = disk.alpha * np.exp(1j * np.linspace(1e-6, 2.0 * np.pi - 1e-6, 721))
    f = (1.0 + 0.5 * delta) / (1.0 - 0.5 * delta)
    return 20.0 * np.log10(np.abs(f)), np.angle(f, deg=True)


def _tightest(done: stability.Stability, in_contact: bool) -> stability.PointStability | None:
    there = [point for point in done.points if point.disks and point.linear.point.in_contact == in_contact]
    return min(there, key=lambda point: min(disk.alpha for disk in point.disks.values()), default=None)


LEVELS = (-1.0, 0.0, 0.02, 0.05, 0.1, 0.2, 0.4, 1.0)
UNSTABLE, NO_POINT = VERMILION, "#d9d9d9"
SHADES = ("#2a788e", "#5aa6a9", "#9accc4", "#cfe6df", "#f4f0dc", "#fdf9cf")
"""From hardly damped to well damped: light is good, as in every map."""


def draw_stability_maps(done: stability.Stability, path: Path) -> None:
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


PASSIVITY_COLORS = dict(zip(AXES, (BLUE, ORANGE, GREEN), strict=True))
PASSIVITY_LEVELS = (-1.0, -0.3, -0.1, 0.0, 1.0)


def draw_passivity(done: passivity.Passivity, path: Path) -> None:
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


def _draw_width(axes: Axes, width: passivity.Width) -> None:
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


DOUBT = 0.03
"""Distance of a drive's model from what was measured that a reader has to know of."""
TURNING = (
    "measured while it turns: at rest its small signals drown in steps or sticking friction, "
    "so the numbers are those of swings that are larger than these"
)
UNTRIED = "the gain limits are the linear model's and were not tried in the co-simulation"
SLIDING = (
    "dry friction (joint_friction_Nm, spring_hysteresis) is not in the linear model, whose joints slide and whose "
    "springs are ideal: small motions are stiffer"
)
HELD = "- where a loop's gain never reaches 1: sticking friction holds the platform there"
BOUND = re.compile(r"k[pi] = [\d.e+-]+ [^ ,]+(?: s\))?|\([^()]*\) mm|[\d.]+ N\b")
COLUMNS = (
    Column("loop", 11, left=True),
    Column("gain margin", 18),
    Column("phase margin", 19),
    Column("M_s", 6, ".2f"),
    Column("M_t", 6, ".2f"),
    Column("-3 dB", 10),
)
AXIS_COLUMNS = (Column("axis", 6, left=True), Column("springs", 14), Column("passive", gap=3, left=True))


def analysis_result(done: stability.Stability, files: Sequence[str] = ()) -> Result:
    """The verdict first, then where its numbers come from, then where `files` are."""
    first, *verdict = _verdict(done)
    plant = done.experiment.plant
    remarks = [
        *(f"{name}: {m.remark}" for judged in done.points for name, m in judged.margins.items() if m.remark),
        *([SLIDING] if plant.joint_friction or plant.spring_hysteresis else []),
        *([UNTRIED] if not done.checks else []),
        *(f"left out: {problem}" for problem in done.problems),
    ]
    held = any(m.crossover is None for judged in done.points for m in judged.margins.values())
    doubt: list[Block] = ["", _tied("", HELD)] if held else []
    parts: list[Block] = [
        *verdict,
        "",
        *(part for judged in done.points for part in _point(judged)),
        *doubt,
        "",
        *_drives(done),
        *(_tied("note  ", text) for text in dict.fromkeys(remarks)),
        "",
    ]
    facts = done.facts() | {"files": [*files]}
    return Result(first, parts, facts, {file: file for file in files}, label=0, exit_code=0 if done.stable else 1)


def point_name(point: OperatingPoint) -> str:
    """`pressing with 5 N at (0, 20, -105) mm`."""
    x, y, z = (round(1e3 * value, 2) + 0.0 for value in point.p_B)
    doing = f"pressing with {point.F_z:.3g} N" if point.in_contact else "in air"
    return f"{doing} at ({x:g}, {y:g}, {z:g}) mm"


def loop_name(name: str) -> str:
    """`position z`."""
    return name.replace("_", " ")


def _verdict(done: stability.Stability) -> Iterator[Block]:
    unstable = [judged for judged in done.points if not judged.stable]
    count = len(done.points)
    left_out = f"; {len(done.problems)} left out" if done.problems else ""
    points = "the operating point" if count == 1 else f"all {count} operating points"
    if unstable:
        points = f"{len(unstable)} of {count} operating points"
    elif not done.stable:
        points += " by the linear model, but not in the co-simulation"
    yield _tied("", f"{done.experiment.name}  {'STABLE' if done.stable else 'UNSTABLE'} at {points}{left_out}")
    for law in ("position", "force"):
        critical = done.critical(law)
        limits = [_checked(done, check) for check in done.checks if check.law == law]
        if critical is not None:
            limits = limits or [_limit(done, law, critical)]
        elif any(law in judged.limits for judged in done.points):
            limits = limits or [f"nothing limits its gains up to {LARGEST_GAIN:g} times what is set"]
        yield from (_tied(f"  {law:8}  ", text) for text in limits)


def _limit(done: stability.Stability, law: str, critical: stability.PointStability) -> str:
    where, factor = point_name(critical.linear.point), critical.limits[law]
    if not factor:
        return f"no gain of it makes the robot stable {where}"
    return f"stable up to {_gains(done, law, factor)}, {factor:.3g} times what is set; beyond, it shakes {where}"


def _checked(done: stability.Stability, check: stability.LimitCheck) -> str:
    where, predicted = point_name(check.point), check.predicted
    if check.holds and predicted is None:
        return f"nothing limits its gains up to {LARGEST_GAIN:g} times what is set, nor in the co-simulation, {where}"
    if predicted is None:
        linear = f"no limit up to {LARGEST_GAIN:g} times what is set"
    else:
        linear = f"{_gains(done, check.law, predicted)}, {predicted:.3g} times what is set"
    if check.holds:
        within = f"the co-simulation agrees within {100 * stability.HOLDS:.0f} %"
        return f"stable up to {linear}; beyond, it shakes {where}; {within}"
    if check.high is None:
        tried = check.low or 0.0
        found = f"no nudge lasts up to {_gains(done, check.law, tried)}, {tried:.3g} times what is set"
    elif check.simulated is None:
        found = f"a nudge lasts down to a {stability.FARTHEST:g}th of that"
    else:
        factor = check.simulated
        found = f"a nudge lasts from {_gains(done, check.law, factor)} on, {factor:.3g} times what is set"
    return (
        f"not predicted for this drive {where}: in the co-simulation {found}; the linear model says {linear}. "
        f"Why: {check.reason}"
    )


def _gains(done: stability.Stability, law: str, factor: float) -> str:
    c = done.experiment.controller
    if law == "position":
        return f"kp = {_digits(factor * c.position.kp)} 1/s"
    terms = [f"kp = {_digits(1e3 * factor * c.force.kp)} mm/N"] if c.force.kp else []
    return ", ".join([*terms, f"ki = {_digits(1e3 * factor * c.force.ki)} mm/(N s)"] if c.force.ki else terms)


def _damping(judged: stability.PointStability) -> str:
    pole = judged.least_damped
    if not judged.stable:
        return f": UNSTABLE, {_growth(judged.poles[0])}"
    if pole.zeta > 0.999:
        return "; nothing swings"
    return f"; swings most at {_hertz(pole.omega)} Hz, zeta {pole.zeta:.2g}"


def _growth(pole: Pole) -> str:
    rate = -pole.zeta * pole.omega
    if pole.zeta < -0.999:
        return f"it runs away, e-fold in {1.0 / rate:.2g} s"
    if rate <= 0.0:
        return "it never comes to rest"
    return f"a swing of {_hertz(pole.omega)} Hz grows e-fold in {1.0 / rate:.2g} s"


def _point(judged: stability.PointStability) -> list[Block]:
    title = _tied("", point_name(judged.linear.point) + _damping(judged))
    if not judged.stable:
        return [title]
    rows: list[Row] = [_row(loop_name(name), m) for name, m in judged.margins.items()]
    rows.append(("all at once", "gain, each", "phase, each", "disk"))
    return [title, Table(COLUMNS, [*rows, *(_disk_row(where, disk) for where, disk in judged.disks.items())])]


def _row(name: str, m: Margins) -> Row:
    gain = f"> {LARGEST_GAIN:g}" if not m.remark else "?"
    if m.gain is not None:
        gain = f"{m.gain:.3g} at {_hertz(m.gain_frequency)} Hz"
    phase = "-" if m.phase is None else f"{math.degrees(m.phase):.0f} deg at {_hertz(m.crossover)} Hz"
    bandwidth = "-" if m.bandwidth is None else f"{_hertz(m.bandwidth)} Hz"
    return name, gain, phase, m.sensitivity, m.complementary, bandwidth


def _disk_row(name: str, disk: DiskMargin) -> Row:
    gain = "any" if disk.gain is None else f"{disk.gain:.3g} at {_hertz(disk.frequency)} Hz"
    return name, gain, f"{math.degrees(disk.phase):.0f} deg", disk.alpha


def _drives(done: stability.Stability) -> Iterator[Note]:
    fits = dict(zip(done.shared.labels, done.shared.drives, strict=True))
    for label, model in fits.items():
        doubt = "; take the numbers with that doubt" if model.residual > DOUBT else ""
        states = counted(len(model.A), "state")
        off = "less than 0.1" if model.residual < 0.001 else f"{100 * model.residual:.2g}"
        yield _tied("drive  ", f"{label}: {states}, {off} % off its measured frequency response{doubt}")
        if model.turning:
            yield _tied("       ", TURNING)


def _digits(value: float) -> str:
    return f"{value:.0f}" if value >= 1000.0 else f"{value:.3g}"


def _hertz(omega: float | None) -> str:
    return f"{(omega or 0.0) / (2.0 * math.pi):.3g}"


def _tied(head: str, text: str) -> Note:
    """`text` after `head`; numbers stay with their units, and what stands in brackets together."""
    tied = BOUND.sub(lambda found: found.group().replace(" ", TIE), text)
    return Note(tied, head, max(2, len(head)), whole=True)


def passivity_result(done: passivity.Passivity, files: Sequence[str] = ()) -> Result:
    """The verdict first: how many points are passive, what is rendered, what was tried; then where `files` are."""
    passive = sum(point.bands["all"] is None and point.stable for point in done.points)
    parts = [
        *([Note(_rendered(done.width), "  renders   ")] if done.width is not None else []),
        *([Note(_carried(done.trial), "  carries   ")] if done.tried else []),
        *(part for point in done.points for part in _passive_point(point)),
        *(Note(f"left out: {problem}", "note  ") for problem in dict.fromkeys(done.problems)),
        "",
    ]
    verdict = f"{done.experiment.name}  passive in the hand at {passive} of {len(done.points)} operating points"
    facts, stable = to_dict(done) | {"files": [*files]}, all(point.stable for point in done.points)
    return Result(Note(verdict, later=4), parts, facts, {file: file for file in files}, 0, 0 if stable else 1)


def _rendered(width: passivity.Width) -> str:
    rendered, stiffness, damping = width.largest
    spring = f"the springs have {width.spring:.4g} N/m there"
    if not rendered:
        return f"no stiffness passively along z; {spring}"
    return (
        f"passively along z up to {rendered:.4g} N/m, asked for {stiffness:.4g} N/m and {damping:.3g} N s/m; {spring}"
    )


def _carried(trial: passivity.PassivityTrial | None) -> str:
    if trial is None:
        return f"{passivity.MASSES[1]:g} kg on the platform in the air, as far as the linear model says"
    inside, outside = (f"{factor * trial.mass:.3g} kg" for factor in (passivity.INSIDE, passivity.OUTSIDE))
    simulated = [f"{growth:+.2g} 1/s" for growth in trial.simulated]
    predicted = [f"{growth:+.2g}" for growth in trial.predicted]
    agrees = "the co-simulation agrees" if trial.confirmed else "the co-simulation does NOT agree"
    return (
        f"up to {trial.mass:.3g} kg on the platform {point_name(trial.point)}; beyond, it swings; {agrees}: "
        f"a nudge goes by {simulated[0]} with {inside} ({predicted[0]} predicted), by {simulated[1]} with {outside} "
        f"({predicted[1]})"
    )


def _passive_point(point: passivity.PointPassivity) -> list[Block]:
    springs = {axis: f"{spring:.0f} N/m" for axis, spring in zip(AXES, point.springs, strict=True)}
    rows = [(axis, springs.get(axis), _passive(point.bands[axis])) for axis in (*AXES, "all")]
    worst = point.worst
    x, y, z = worst.direction
    environment = f"{worst.mass:.3g} kg on {worst.stiffness:.3g} N/m along ({x:.2f}, {y:.2f}, {z:.2f})"
    swings = f"{environment}, swings at {worst.frequency:.2g} Hz, {worst.growth:+.2g} 1/s"
    return [
        "",
        Note(point_name(point.point) + ("" if point.stable else ": UNSTABLE in an empty hand")),
        Table(AXIS_COLUMNS, rows),
        Note(
            f"worst environment: {swings if worst.swings else f'none swings; slowest to die out {environment}'}", "  "
        ),
    ]


def _passive(band: passivity.Band | None) -> str:
    if band is None:
        return "at all frequencies"
    return f"not from {band.low:.2g} to {band.high:.3g} Hz; gives back {-100.0 * band.least:.0f} % at {band.at:.2g} Hz"
