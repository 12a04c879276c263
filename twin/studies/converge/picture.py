"""Picture of a coupling study: error over the tick, and over the computing time."""

from math import isfinite
from pathlib import Path
from typing import Any

import numpy as np

from twin.studies.converge.convergence import CouplingSeries, CouplingStudy
from twin.studies.converge.signals import FORCE_SIGNAL, Signal
from twin.studies.figure import BLUE, GREEN, INK, ORANGE, PINK, RED, SKY, Axes, picture

CURVE_STYLES = ((BLUE, "o"), (ORANGE, "s"), (GREEN, "^"), (PINK, "D"), (SKY, "v"))


def draw_convergence(study: CouplingStudy, path: Path) -> None:
    """Draw the errors of a coupling study over tick and computing time to `path` (PNG)."""
    from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

    with picture(path, 11, 5.6) as figure:
        by_tick, by_cost = figure.subplots(1, 2, sharey=True)
        signal = study.judged_signal
        for one, (color, marker) in zip(study.series, CURVE_STYLES, strict=False):
            points = [point for point in one.points if isfinite(point.cost)]
            error = [signal.scale * point.errors[signal.name] for point in points]
            # hollow markers, because the last two curves often coincide
            style = {"color": color, "marker": marker, "ms": 6, "lw": 1.4, "mfc": "none", "mew": 1.5}
            by_tick.plot([1e3 * point.tick for point in points], error, label=_label(one, signal), **style)
            by_cost.plot([1e3 * point.cost for point in points], error, **style)
        _draw_slopes(by_tick, study)
        for axes in (by_tick, by_cost):
            axes.set(xscale="log", yscale="log")
        ticks = sorted({1e3 * point.tick for one in study.series for point in one.points})
        by_tick.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
        by_tick.minorticks_off()
        if study.reference.is_pressing:
            _draw_tolerance(by_tick, by_cost, study)
        by_tick.set(xlabel="tick (ms)", ylabel=f"largest error of {signal.name} ({signal.unit})")
        by_cost.set_xlabel("computing per simulated second (ms)")
        by_cost.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        by_cost.xaxis.set_major_formatter(FormatStrFormatter("%g"))
        by_cost.xaxis.set_minor_formatter(NullFormatter())
        figure.legend(loc="outside lower center", fontsize="small", ncols=3)
        by_tick.set_title(f"{study.name}: cost of the coupling", loc="left", fontweight="bold")


def _draw_tolerance(by_tick: Axes, by_cost: Axes, study: CouplingStudy) -> None:
    limit = FORCE_SIGNAL.scale * study.tolerance
    for axes in (by_tick, by_cost):
        axes.axhline(limit, color=RED, lw=1.0, ls="--")
    by_tick.annotate(
        f"tolerance, {limit:g} mN", (0.01, limit), (2, 3),
        xycoords=("axes fraction", "data"), textcoords="offset points", color=RED, fontsize="small",
    )  # fmt: skip
    if study.choice is None:
        return
    point = study.choice.point
    error = FORCE_SIGNAL.scale * point.errors[FORCE_SIGNAL.name]
    ring: dict[str, Any] = {"marker": "o", "ms": 15, "mfc": "none", "mec": INK, "mew": 1.2, "ls": "none"}
    by_tick.plot(1e3 * point.tick, error, label="recommended", **ring)
    by_cost.plot(1e3 * point.cost, error, **ring)


def _label(one: CouplingSeries, signal: Signal) -> str:
    slope = one.orders[signal.name].slope
    return one.coupling.name + (f": order {slope:.2f}" if slope is not None else "")


def _draw_slopes(axes: Axes, study: CouplingStudy) -> None:
    """Draw lines of slope 1 and 2 at twice the largest error, for held and linear inputs."""
    signal = study.judged_signal
    for order in (1, 2):
        series = [one for one in study.series if one.coupling.expected_order == order]
        points = [point for one in series for point in one.points if isfinite(point.cost)]
        if not points:
            continue
        ticks = np.array(sorted({point.tick for point in points}))
        top = max(point.errors[signal.name] for point in points if point.tick == ticks[-1])
        line = signal.scale * 2.0 * top * (ticks / ticks[-1]) ** order
        axes.plot(1e3 * ticks, line, color="0.6", lw=1.0, ls=":")
        axes.annotate(
            f"slope {order}", (1e3 * ticks[len(ticks) // 2], line[len(ticks) // 2]), (0, 8),
            textcoords="offset points", color="0.45", fontsize="small", ha="right",
        )  # fmt: skip
