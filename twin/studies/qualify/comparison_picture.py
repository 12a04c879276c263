"""Several drives in the same experiment, laid over each other."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from twin.studies.figure import save
from twin.studies.metrics.response import Curve, first_time
from twin.studies.qualify.comparison import Trial
from twin.studies.qualify.true_run import STILL, TrueRun

COLORS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#6a3d9a", "#1c1c1c")
"""Okabe and Ito's, which colour-blind readers can tell apart."""
REFERENCE = "#8c8c8c"
CLOSE_UP = 2.5
"""How much (s) of the approach the second panel shows."""


def draw_drive_compare(trials: Sequence[Trial], title: str, path: Path) -> None:
    """Write the picture to `path` (PNG): what is controlled, its approach, the error of z, error in the second half.

    What is controlled is the true pressing force if the robot touches anything, else the true z.
    """
    figure = Figure(figsize=(11, 7.5), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    (whole, start), (z_error, late) = figure.subplots(2, 2)
    runs = [trial.run for trial in trials]
    touching = any(np.any(run.F_z > 0.0) for run in runs)
    longest = max(runs, key=lambda run: len(run.t))
    end = float(longest.t[-1])
    for axes in (whole, start):
        axes.plot(longest.t, _wanted(longest, touching), color=REFERENCE, lw=1.4, label="reference" * (axes is whole))
    for i, trial in enumerate(trials):
        run, look = trial.run, {"color": COLORS[i % len(COLORS)], "ls": ("-", "--")[i // len(COLORS) % 2]}
        whole.plot(run.t, _true(run, touching), lw=1.1, label=trial.name + " (failed)" * bool(trial.failure), **look)
        start.plot(run.t, _true(run, touching), lw=1.3, **look)
        z_error.plot(run.t, 1e3 * (run.z - run.z_ref), lw=1.1, **look)
        half = slice(len(longest.t) // 2, None)
        late.plot(run.t[half], _true(run, touching)[half] - _wanted(run, touching)[half], lw=1.1, **look)
    first = min(_approach_begins(run, touching) for run in runs)
    quantity = "true pressing force F_z (N)" if touching else "true z (mm)"
    for axes, label, limits in (
        (whole, quantity, (0.0, end)),
        (start, f"{quantity}, approach", (max(0.0, first - 0.2), min(end, first + CLOSE_UP))),
        (z_error, "true z minus pre-defined z (mm)", (0.0, end)),
        (late, f"{quantity.split(' (')[0]} minus reference ({'N' if touching else 'mm'})", (0.5 * end, end)),
    ):
        axes.set(xlabel="time (s)", ylabel=label, xlim=limits)
        axes.grid(alpha=0.25)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    figure.legend(loc="outside lower center", ncols=min(5, len(trials) + 1), frameon=False)
    figure.suptitle(title, x=0.01, ha="left", fontweight="bold")
    save(figure, path)


def _true(run: TrueRun, touching: bool) -> Curve:
    return run.F_z if touching else 1e3 * run.z


def _wanted(run: TrueRun, touching: bool) -> Curve:
    return run.F_z_ref if touching else 1e3 * run.z_ref


def _approach_begins(run: TrueRun, touching: bool) -> float:
    """When it first touches, or when the reference first moves (s); the end where neither ever happens."""
    happening = run.F_z > 0.0 if touching else np.abs(run.z_ref - run.z_ref[0]) > STILL
    return min(first_time(run.t, happening), float(run.t[-1]))
