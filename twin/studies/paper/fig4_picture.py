"""Fig. 4 A-D as one picture: panels and colours as the caption of the paper names them."""

from contextlib import suppress
from pathlib import Path

from matplotlib.axes import Axes

from twin.recording.errors import UnknownSeries
from twin.studies.figure import GREY, INK, PAPER_BLUE, PAPER_ORANGE, PAPER_YELLOW, picture
from twin.studies.paper.fig4_runs import Fig4Run, Fig4Runs

PRE_DEFINE, P_BASED, FP_BASED, FP_REFERENCE, TRUTH = PAPER_BLUE, PAPER_YELLOW, PAPER_ORANGE, GREY, INK
WIDE, THIN = 1.6, 0.9
"""Weights of lines (pt), the same in all panels; legends have one order, too."""


def draw_fig4(runs: Fig4Runs, path: Path) -> None:
    """Write the picture to `path` (PNG). Forces are the controller's estimates; the true F_z is dotted.

    A series that a run lacks is left out.
    """
    with picture(path, 12, 7.5) as figure:
        (a, b), (c, d) = figure.subplots(2, 2, sharex=True)
        _draw_z(a, runs)
        _draw_force(b, runs)
        _draw_friction(c, runs.imperfect, 0, "x")
        _draw_friction(d, (runs.force_position, runs.position), 1, "y")
        limits = [min(c.get_ylim()[0], d.get_ylim()[0]), max(c.get_ylim()[1], d.get_ylim()[1])]
        c.set_ylim(*limits)
        d.set_ylim(*limits)
        for axes, letter in ((a, "A"), (b, "B"), (c, "C"), (d, "D")):
            axes.set_title(letter, loc="left", fontweight="bold")
            axes.set_xlim(0, 20)
        # ideal runs have no force in x, by symmetry
        text = runs.without_x or "imperfect runs: scale tilted, encoders off zero"
        c.set_title(text, loc="right", fontsize="small")
        for axes in (c, d):
            axes.set_xlabel("time (s)")


def _draw_z(axes: Axes, runs: Fig4Runs) -> None:
    fp, p = runs.force_position, runs.position
    with suppress(UnknownSeries):
        axes.plot(fp.t, 1e3 * fp.z_ref, color=PRE_DEFINE, lw=WIDE, label="Pre-define")
    axes.plot(p.t, 1e3 * p.z, color=P_BASED, lw=WIDE, label="P-based")
    axes.plot(fp.t, 1e3 * fp.z, color=FP_BASED, lw=WIDE, label="F&P-based")
    with suppress(UnknownSeries):
        axes.plot(fp.t, 1e3 * fp.z_cmd, color=FP_REFERENCE, lw=THIN, label="F&P-based-ref")
    axes.set_ylabel("z position (mm)")
    axes.legend(loc="upper right")


def _draw_force(axes: Axes, runs: Fig4Runs) -> None:
    fp, p = runs.force_position, runs.position
    with suppress(UnknownSeries):
        axes.axhline(fp.F_z_ref, color=PRE_DEFINE, lw=WIDE, label="Pre-define")
    for run, color, label in ((p, P_BASED, "P-based"), (fp, FP_BASED, "F&P-based")):
        with suppress(UnknownSeries):
            axes.plot(run.t, run.F_z, color=color, lw=WIDE, label=label)
    axes.plot(p.t_plant, p.true_F_z, color=TRUTH, lw=THIN, ls=":", label="true force (plant)")
    axes.plot(fp.t_plant, fp.true_F_z, color=TRUTH, lw=THIN, ls=":")
    axes.set_ylabel("F_z, pressing (N)")
    axes.legend(loc="lower right")


def _draw_friction(axes: Axes, pair: tuple[Fig4Run, Fig4Run] | None, axis: int, letter: str) -> None:
    axes.axhline(0.0, color=PRE_DEFINE, lw=WIDE, label="Pre-define")
    # noise drawn wide is a block of colour
    for run, color, label in zip(reversed(pair or ()), (P_BASED, FP_BASED), ("P-based", "F&P-based"), strict=False):
        axes.plot(run.t, run.F_ee_B[:, axis], color=color, lw=THIN, label=label)
    axes.set_ylabel(f"F_{letter} (N)")
    axes.legend(loc="lower left")
