"""A replay as one picture: forces, residuals, and the sums that raise the alarm."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from twin.studies.figure import INK, JOINTS, PAPER_BLUE, PAPER_ORANGE, PAPER_YELLOW, RED, picture
from twin.studies.replay.replay import Indicator, Replay, pressing

MEASURED, ESTIMATE, TWIN, PLANT, ALARM = INK, PAPER_YELLOW, PAPER_ORANGE, PAPER_BLUE, RED


def draw_replay(replay: Replay, name: str, path: Path) -> None:
    """Write the picture to `path` (PNG)."""
    force = [one for one in replay.indicators if one.unit == "N"]
    joints = [one for one in replay.indicators if one.unit == "rad"]
    panels = 1 + bool(force) + bool(joints) + bool(replay.indicators)
    with picture(path, 11, 1.2 + 2.3 * panels) as figure:
        axes = list(np.atleast_1d(figure.subplots(panels, 1, sharex=True)))
        rest = iter(axes)
        _draw_forces(next(rest), replay)
        if force:
            _draw_force_residual(next(rest), force[0])
        if joints:
            _draw_joint_residuals(next(rest), joints)
        if replay.indicators:
            _draw_sums(next(rest), replay.indicators)
        first = replay.first_alarm
        for panel in axes:
            panel.margins(x=0)
            for start, end in replay.log.gaps:
                panel.axvspan(start, end, color="0.9")
            if first is not None:
                panel.axvspan(first.drift.since, replay.log.t[-1], color=ALARM, alpha=0.06)
                panel.axvline(first.drift.alarm, color=ALARM, lw=1.0)
        axes[0].set_title(_title(replay, name), loc="left", fontweight="bold")
        axes[-1].set_xlabel("time (s)")


def _title(replay: Replay, name: str) -> str:
    first = replay.first_alarm
    if first is not None:
        return f"{name}: robot and twin part since {first.drift.since:.1f} s ({first.name})"
    return f"{name}: " + ("robot and twin match" if replay.indicators else "nothing to compare the estimate with")


def _draw_forces(axes: Axes, replay: Replay) -> None:
    t = replay.log.t
    axes.plot(t, pressing(replay.estimator), color=ESTIMATE, lw=0.9, label="estimate")
    if replay.twin is not replay.estimator:
        axes.plot(t, pressing(replay.twin), color=TWIN, lw=0.9, label="estimate, dead zone taken off")
    if replay.plant is not None:
        axes.plot(t, pressing(replay.plant), color=PLANT, lw=1.2, label="plant model")
    if replay.log.force is not None:
        force = replay.log.force
        axes.step(force.t, force.values, where="post", color=MEASURED, lw=1.0, label="measured")
    axes.set_ylabel("F_z, pressing (N)")
    axes.legend(loc="best", fontsize="small")


def _draw_force_residual(axes: Axes, one: Indicator) -> None:
    _draw_residual(axes, one, 1.0, TWIN, "estimate, dead zone taken off, less measured: means of blocks")
    axes.set_ylabel("force residual (N)")
    axes.legend(loc="best", fontsize="small")


def _draw_joint_residuals(axes: Axes, joints: list[Indicator]) -> None:
    for one, color in zip(joints, JOINTS, strict=True):
        _draw_residual(axes, one, float(np.degrees(1.0)), color, f"{one.name}, model less robot")
    axes.set_ylabel("joint residual (deg)")
    axes.legend(loc="best", fontsize="small", ncols=3)


def _draw_residual(axes: Axes, one: Indicator, scale: float, color: str, label: str) -> None:
    """Samples faint, means of blocks as steps, the band in which no sum fills."""
    d = one.drift
    axes.plot(one.t, scale * one.r, color=color, lw=0.5, alpha=0.3)
    edges = np.concatenate([[d.t[0] - d.block], d.t])
    axes.stairs(scale * d.mean, edges, color=color, lw=1.8, baseline=None, label=label)
    for side in (-1.0, 1.0):
        axes.axhline(
            scale * (d.baseline + side * d.slack),
            color="0.5",
            lw=0.8,
            ls="--",
            label="no sum fills in here" if side > 0 and one.name in ("force", "joint 1") else None,
        )
    # single samples may be far off for a moment; what counts are the means
    reach = scale * max(3.0 * d.slack, 1.3 * float(np.max(np.abs(d.mean - d.baseline))))
    low, high = axes.get_ylim() if axes.has_data() and axes.lines else (0.0, 0.0)
    middle = scale * d.baseline
    axes.set_ylim(
        min(middle - reach, max(low, middle - 2.0 * reach)), max(middle + reach, min(high, middle + 2.0 * reach))
    )


def _draw_sums(axes: Axes, indicators: tuple[Indicator, ...]) -> None:
    for one in indicators:
        d = one.drift
        worst = np.where(d.up >= d.low, d.up, -d.low) / d.threshold
        color = TWIN if one.unit == "N" else JOINTS[int(one.name[-1]) - 1]
        axes.plot(d.t, worst, marker=".", lw=1.2, color=color, label=one.name)
    for side in (-1.0, 1.0):
        axes.axhline(side, color=ALARM, lw=0.9, ls="--", label="alarm" if side > 0 else None)
    axes.set_ylabel("cumulative sum / H")
    low, high = axes.get_ylim()
    axes.set_ylim(max(min(low, -1.4), -4.0), min(max(high, 1.4), 4.0))
    axes.legend(loc="best", fontsize="small", ncols=4)
