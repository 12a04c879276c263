"""A qualification run as one picture: step, load step, frequency response, overload."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from twin.studies.figure import GREY, INK, PAPER_BLUE, picture
from twin.studies.qualify.bench import Response
from twin.studies.qualify.frequency import NOTHING
from twin.studies.qualify.operating_range import LOAD_IN_USE, LOAD_PEAK, SPEED_IN_USE, TICK
from twin.studies.qualify.qualification import Qualification
from twin.studies.qualify.step import BAND
from twin.studies.qualify.work_cycle import COMMANDED, LOADED

COMMAND, SPEED, LOAD, MARK = GREY, PAPER_BLUE, "#c2571a", INK
BEFORE, AFTER = 0.02, 0.25
"""How much of a step is shown (s)."""


def draw_drive_check(done: Qualification, path: Path) -> None:
    """Write the picture to `path` (PNG)."""
    verdict = "qualified" if not done.failed else "NOT qualified: " + ", ".join(done.failed)
    with picture(path, 11, 7, f"{done.plan.label}   {verdict}") as figure:
        (a, b), (c, d) = figure.subplots(2, 2)
        curves = done.curves
        if curves.cycle is not None:
            _draw_step(a, done, curves.cycle)
            _draw_load_step(b, curves.cycle)
        if len(curves.frequencies):
            _draw_frequency_response(c, done)
        if curves.overload is not None:
            _draw_overload(d, done, curves.overload)
        titles = ("Step of the command", f"Step of the load to {LOAD_IN_USE:g} N m", "Small signals", "Growing load")
        for axes, title in zip((a, b, c, d), titles, strict=True):
            axes.set_title(title, loc="left")
            if not axes.has_data():
                axes.text(0.5, 0.5, "the drive failed", ha="center", va="center", transform=axes.transAxes)


def _draw_step(axes: Axes, done: Qualification, cycle: Response) -> None:
    part = cycle.window(COMMANDED - BEFORE, COMMANDED + AFTER)
    t = 1e3 * (cycle.t[part] - COMMANDED)
    axes.plot(t, cycle.omega_ref[part], color=COMMAND, lw=1.2, drawstyle="steps-post", label="command")
    axes.plot(t, cycle.omega_m[part], color=SPEED, lw=1.6, label="speed")
    final = done.value("speed") or 0.0
    axes.axhspan((1.0 - BAND) * final, (1.0 + BAND) * final, color=SPEED, alpha=0.10, lw=0, label="±5 %")
    settled = done.value("settling_time")
    if settled is not None and settled < AFTER:
        axes.axvline(1e3 * settled, color=MARK, lw=0.9, ls=":", label=f"settled, {1e3 * settled:.0f} ms")
    axes.set(xlabel="time after the step (ms)", ylabel="motor speed (rad/s)")
    axes.legend(loc="lower right")


def _draw_load_step(axes: Axes, cycle: Response) -> None:
    part = cycle.window(LOADED - BEFORE, LOADED + AFTER)
    t = 1e3 * (cycle.t[part] - LOADED)
    axes.plot(t, cycle.omega_ref[part], color=COMMAND, lw=1.2, label="command")
    axes.plot(t, cycle.omega_m[part], color=SPEED, lw=1.6, label="speed")
    # a drive that does not feel its load would be drawn at the scale of rounding
    low, high = axes.get_ylim()
    axes.set_ylim(min(low, SPEED_IN_USE - 0.1), max(high, SPEED_IN_USE + 0.05))
    axes.axvline(0.0, color=LOAD, lw=0.9, ls=":", label="load comes on")
    axes.set(xlabel="time after the step (ms)", ylabel="motor speed (rad/s)")
    axes.legend(loc="lower right")


def _draw_frequency_response(axes: Axes, done: Qualification) -> None:
    f, gain = done.curves.frequencies, done.curves.gain
    if not gain[0] > 0.0:
        axes.text(0.5, 0.5, "it does not follow its command", ha="center", va="center", transform=axes.transAxes)
        return
    decibel = 20.0 * np.log10(np.maximum(gain / gain[0], NOTHING))
    axes.semilogx(f, decibel, color=SPEED, lw=1.6, marker="o", ms=3)
    axes.axhline(-3.0, color=MARK, lw=0.9, ls=":")
    bandwidth = done.value("bandwidth")
    if bandwidth is not None:
        axes.axvline(bandwidth, color=MARK, lw=0.9, ls=":")
        axes.annotate(
            f"-3 dB at {bandwidth:.3g} Hz",
            (bandwidth, -3.0),
            (-8, -12),
            textcoords="offset points",
            ha="right",
            va="top",
        )
    axes.set_ylim(max(-40.0, min(-12.0, float(np.min(decibel)) - 2.0)), max(6.0, float(np.max(decibel)) + 2.0))
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set(xlabel="frequency (Hz)", ylabel="speed over command (dB)")


def _draw_overload(axes: Axes, done: Qualification, overload: Response) -> None:
    n = round(0.05 / TICK)
    speed = (overload.theta_m[n:] - overload.theta_m[:-n]) / (n * TICK)
    load = overload.tau_load[n // 2 : n // 2 + len(speed)]
    axes.plot(load, speed, color=SPEED, lw=1.4, label="speed, mean of 50 ms")
    axes.axvspan(0.0, LOAD_IN_USE, color=COMMAND, alpha=0.15, lw=0, label="in use")
    axes.axvline(LOAD_PEAK, color=COMMAND, lw=0.9, ls="--", label=f"peak, {LOAD_PEAK:g} N m")
    stall = done.value("stall_torque")
    if stall is not None:
        axes.axvline(stall, color=MARK, lw=0.9, ls=":", label=f"stall, {stall:.3g} N m")
    axes.set_ylim(-0.3 * SPEED_IN_USE, 1.6 * SPEED_IN_USE)
    axes.set_xlim(0.0, max(1.1 * LOAD_PEAK, 1.1 * (stall or float(load[-1]))))
    axes.set(xlabel="load (N m)", ylabel="motor speed (rad/s)")
    axes.legend(frameon=True, edgecolor="none", framealpha=0.9, loc="lower left")
