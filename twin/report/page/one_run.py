"""One run in the panels and colours that the caption of Fig. 4 names: height, pressing force, F_x and F_y."""

from pathlib import Path

from matplotlib.axes import Axes

from twin.studies.figure import picture
from twin.studies.metrics.response import Curve
from twin.studies.paper.fig4_runs import FP_BASED, FP_REFERENCE, PRE_DEFINE, TRUTH, Fig4Run


def draw_one_run(run: Fig4Run, path: Path) -> None:
    """Write the picture to `path` (PNG): the robot's own estimates coloured, the truth dotted."""
    with picture(path, 12, 7.5, by_hand=True) as figure:
        (height, force), (x, y) = figure.subplots(2, 2, sharex=True)
        # a layout that is worked out draws everything twice
        figure.subplots_adjust(left=0.075, right=0.99, top=0.96, bottom=0.07, hspace=0.12, wspace=0.2)
        height.plot(run.t, 1e3 * run.z_cmd, color=FP_REFERENCE, lw=1.2, label="after the force loop")
        height.plot(run.t, 1e3 * run.z_ref, color=PRE_DEFINE, lw=1.6, label="pre-defined")
        height.plot(run.t, 1e3 * run.z, color=FP_BASED, lw=1.6, label="estimated")
        _dotted(height, run.t_plant, 1e3 * run.true_z)
        height.set_ylabel("z position (mm)")
        force.plot(run.t, run.recording["controller.F_z_ref"], color=PRE_DEFINE, lw=1.6, label="reference")
        force.plot(run.t, run.F_z, color=FP_BASED, lw=1.6, label="estimated")
        _dotted(force, run.t_plant, run.true_F_z)
        force.set_ylabel("F_z, pressing (N)")
        for axes, axis, letter in ((x, 0, "x"), (y, 1, "y")):
            axes.plot(run.t, run.F_ee_B[:, axis], color=FP_BASED, lw=0.9, label="estimated")
            _dotted(axes, run.t_plant, run.true_F_ee_B[:, axis])
            axes.set(ylabel=f"F_{letter} (N)", xlabel="time (s)")
        for axes, letter in zip((height, force, x, y), "ABCD", strict=True):
            axes.set_title(letter, loc="left", fontweight="bold")
            axes.legend()


def _dotted(axes: Axes, t: Curve, values: Curve) -> None:
    axes.plot(t, values, color=TRUTH, lw=0.9, ls=":", label="true")
