"""An identification as one picture: what the model leaves unexplained, and what the paper's procedure makes of it."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from twin.studies.figure import INK, JOINTS, PAPER_BLUE, PAPER_ORANGE, RED, picture
from twin.studies.identify.identification import Identification
from twin.studies.identify.windows import JOINTS_PER_METRE

LOADING, UNLOADING = PAPER_BLUE, PAPER_ORANGE
STILL = 5e-4
"""m/s: slower in z is neither loading nor unloading."""


def draw_identification(one: Identification, name: str, path: Path) -> None:
    """Write the picture to `path` (PNG)."""
    k = one.estimate("k_s_eta")
    with picture(path, 11, 8, f"{name}: k_s eta = {k.value:.4f} +- {k.half_width:.4f} N m/rad") as figure:
        draws = (_draw_force, _draw_air, _draw_depth, _draw_paper)
        for draw, panel in zip(draws, figure.subplots(2, 2).flat, strict=True):
            draw(panel, one)


def _of_kind(one: Identification, kind: int) -> tuple[np.ndarray, np.ndarray]:
    """Residuals of the equations of one kind, and their windows."""
    rows = one.fit.rows
    return rows.residual[rows.kind == kind], rows.window[rows.kind == kind]


def _draw_force(axes: Axes, one: Identification) -> None:
    _, window = _of_kind(one, 1)
    F, r = one.fit.seen.force[window], one.fit.force_residual
    _draw_halves(axes, one, window, F, r)
    for side in (-0.5, 0.5):
        axes.axhline(side * max(one.model.resolution, 0.0), color="0.5", lw=0.8, ls="--")
    axes.set_title("on the scale: force by the springs less the reading", fontsize="medium", loc="left")
    axes.set(xlabel="scale (N); dashed: half a step of its display", ylabel="residual (N)")
    if len(F):
        axes.legend(fontsize="small", loc="best")


def _draw_halves(axes: Axes, one: Identification, window: np.ndarray, x: np.ndarray, y: np.ndarray) -> None:
    down = np.mean(one.fit.seen.speed[window], axis=1) / JOINTS_PER_METRE
    for chosen, color, label in (
        (down > STILL, LOADING, "loading"),
        (down < -STILL, UNLOADING, "unloading"),
        (np.abs(down) <= STILL, "0.6", "sweeping"),
    ):
        if np.any(chosen):
            axes.plot(x[chosen], y[chosen], ".", ms=4, color=color, alpha=0.7, label=label)


def _draw_air(axes: Axes, one: Identification) -> None:
    r, window = _of_kind(one, 0)
    t = one.fit.seen.t[window[::3]]
    for i, color in enumerate(JOINTS):
        axes.plot(t, np.degrees(r[i::3]), ".", ms=3, color=color, alpha=0.7, label=f"joint {i + 1}")
    axes.set_title("in free air: wind-up less that of the robot's weight", fontsize="medium", loc="left")
    axes.set(xlabel="time (s)", ylabel="residual (deg, motor side)")
    if len(t):
        axes.legend(fontsize="small", loc="best", ncols=3)


def _draw_depth(axes: Axes, one: Identification) -> None:
    r, window = _of_kind(one, 2)
    _draw_halves(axes, one, window, one.fit.seen.force[window], 1e6 * r)
    axes.set_title("the scale's own law: height less z_s - F/K/(1 - c p_z')", fontsize="medium", loc="left")
    axes.set(xlabel="scale (N)", ylabel="residual (micrometres)")


def _draw_paper(axes: Axes, one: Identification) -> None:
    axes.set_title("Sec. III.A as printed: one press, a line through 0", fontsize="medium", loc="left")
    press = one.one_pose
    if press is None:
        axes.text(0.5, 0.5, "no gradual press in one place", ha="center", va="center", transform=axes.transAxes)
        return
    believed = one.model.belief.k_s * one.model.belief.eta
    axes.plot(press.calculated, press.force, "o", ms=4, color=INK, label="measured, against (27)")
    reach = np.array([min(0.0, float(press.calculated.min())), float(press.calculated.max())])
    slope = press.steps[0].k_s_eta / believed
    axes.plot(reach, slope * reach, color=RED, label=f"as printed: k_s eta = {press.steps[0].k_s_eta:.3f}")
    slope = one.fit.x[0] / believed
    middle = press.calculated.mean(), press.force.mean()
    axes.plot(
        reach, middle[1] + slope * (reach - middle[0]), color=LOADING, ls="--",
        label=f"slope of the identified {one.fit.x[0]:.3f}",
    )  # fmt: skip
    axes.set(xlabel="F_z by (20) to (27), believed k_s eta (N)", ylabel="scale (N)")
    axes.legend(fontsize="small", loc="best")
