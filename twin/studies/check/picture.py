"""Curves that have left their tubes: the tube around the baseline, and what is now."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from twin.studies.check.verdict import CheckVerdict, Outside
from twin.studies.compare.picture import A_COLOUR, B_COLOUR, OUT_COLOUR
from twin.studies.compare.text import shown
from twin.studies.figure import picture
from twin.writing import made_folder

MOST = 5
"""Checks of which there are pictures: those that are told in full."""


def check_pictures(verdicts: Sequence[CheckVerdict], folder: Path) -> list[Path]:
    """Draw the first MOST of `verdicts` with curves outside, a PNG each in `folder`; the files.

    Raises:
        InputRefused, NotWritten: the disk refuses.
    """
    drawn = []
    made_folder(folder)
    for verdict in [verdict for verdict in verdicts if verdict.outside][:MOST]:
        path = folder / f"{verdict.experiment}_{Path(verdict.drive).stem}.png"
        _draw_verdict(verdict, path)
        drawn.append(path)
    return drawn


def _draw_verdict(verdict: CheckVerdict, path: Path) -> None:
    with picture(path, 8.0, 3.2 * len(verdict.outside) + 0.5) as figure:
        panels = figure.subplots(len(verdict.outside), squeeze=False)[:, 0]
        for axes, curve in zip(panels, verdict.outside, strict=True):
            _draw(axes, curve)
        panels[-1].set_xlabel("time (s)")
        figure.suptitle(f"{verdict.experiment}, {verdict.drive}", fontsize=11)
        figure.legend(*panels[0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=9)


def _draw(axes: Axes, curve: Outside) -> None:
    unit, factor = shown(curve.unit)
    t = np.array(curve.t)
    before, lower, upper, now = (
        factor * np.array(line) for line in (curve.before, curve.lower, curve.upper, curve.now)
    )
    out = (now < lower) | (now > upper)
    axes.fill_between(t, lower, upper, color=A_COLOUR, alpha=0.25, lw=0, label="tolerance tube")
    axes.plot(t, before, color=A_COLOUR, lw=1.6, label="baseline")
    axes.plot(t, now, color=B_COLOUR, lw=1.0, marker=".", label="now")
    axes.plot(t[out], now[out], "o", mfc="none", color=OUT_COLOUR, ms=7, label="outside")
    axes.set_title(f"{curve.name}: {curve.signal}", loc="left", fontsize=10)
    axes.set_ylabel(unit or "1")
