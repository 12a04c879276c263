"""Several drives in the same experiment, laid over each other."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from twin.studies.figure import BLUE, GREEN, GREY, INK, ORANGE, PINK, SKY, VERMILION, picture
from twin.studies.metrics.response import Curve, first_time
from twin.studies.qualify.comparison import DriveTrial
from twin.studies.qualify.true_run import STILL, TrueRun

COLORS = (BLUE, ORANGE, GREEN, PINK, SKY, VERMILION, "#6a3d9a", INK)
CLOSE_UP = 2.5
"""How much (s) of the approach the second panel shows."""


def draw_drive_compare(trials: Sequence[DriveTrial], title: str, path: Path) -> None:
    """Write the picture to `path` (PNG): what is controlled, its approach, the error of z, error in the second half.

    What is controlled is the true pressing force if the robot touches anything, else the true z.
    """
    with picture(path, 11, 7.5, title) as figure:
        (whole, start), (z_error, late) = figure.subplots(2, 2)
        runs = [trial.run for trial in trials]
        touching = any(np.any(run.F_z > 0.0) for run in runs)
        longest = max(runs, key=lambda run: len(run.t))
        # where all have failed in the first step there is no time to be drawn
        end = float(longest.t[-1]) or longest.run.tick
        for axes in (whole, start):
            axes.plot(longest.t, _wanted(longest, touching), color=GREY, lw=1.4, label="reference" * (axes is whole))
        for i, trial in enumerate(trials):
            run, look = trial.run, {"color": COLORS[i % len(COLORS)], "ls": ("-", "--")[i // len(COLORS) % 2]}
            name = trial.name + " (failed)" * bool(trial.failure)
            whole.plot(run.t, _true(run, touching), lw=1.1, label=name, **look)
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
        figure.legend(loc="outside lower center", ncols=min(5, len(trials) + 1))


def _true(run: TrueRun, touching: bool) -> Curve:
    return run.F_z if touching else 1e3 * run.z


def _wanted(run: TrueRun, touching: bool) -> Curve:
    return run.F_z_ref if touching else 1e3 * run.z_ref


def _approach_begins(run: TrueRun, touching: bool) -> float:
    """When it first touches, or when the reference first moves (s); the end where neither ever happens."""
    happening = run.F_z > 0.0 if touching else np.abs(run.z_ref - run.z_ref[0]) > STILL
    return min(first_time(run.t, happening), float(run.t[-1]))
