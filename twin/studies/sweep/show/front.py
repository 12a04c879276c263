"""What trades off in a sweep: every run over two metrics, the front that no run beats, failures counted."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin.studies.figure import BLUE, GREEN, INK, ORANGE, PINK, SKY, VERMILION, picture
from twin.studies.lines import counted
from twin.studies.sweep.folder import KeptRows
from twin.studies.sweep.rows import Row
from twin.studies.sweep.show.parts import Asked
from twin.studies.sweep.statistics.pareto import pareto_front
from twin.studies.sweep.statistics.ranking import best, drives_in, value

COLORS = (BLUE, VERMILION, GREEN, PINK, ORANGE, SKY, "#000000")
MARKERS = "osD^vP*X"


def draw_front(kept: KeptRows, asked: Asked, path: Path) -> None:
    """Write the picture to `path` (PNG).

    Raises:
        NotWritten: the disk refuses.
    """
    with picture(path, 7.5, 4.8) as figure:
        axes = figure.subplots()
        ranked = best(kept.rows, asked.by)
        for number, drive in enumerate(drives_in(kept.rows)):
            mine = [row for row in ranked if row["drive"] == drive]
            x, y = _points(mine, asked)
            axes.scatter(
                x, y, s=26, color=COLORS[number % len(COLORS)], marker=MARKERS[number % len(MARKERS)],
                alpha=0.75, lw=0, label=f"{drive or 'runs'} ({len(mine)})",
            )  # fmt: skip
        x, y = _points(pareto_front(ranked, asked.by, asked.against), asked)
        axes.step(x, y, where="post", color=INK, lw=1.2, label="Pareto front")
        axes.scatter(x, y, s=70, facecolors="none", edgecolors=INK, lw=1.2)
        axes.set(xlabel=f"{asked.by} (less is better)", ylabel=f"{asked.against} (less is better)")
        axes.legend()
        absent = len(kept.rows) - len(ranked)
        text = f"; {counted(absent, 'run')} not shown: failed, tripped or beyond the limits" if absent else ""
        figure.suptitle(f"{kept.name}: {len(ranked)} of {kept.runs} runs{text}", x=0.01, ha="left", fontsize=10)


def _points(rows: Sequence[Row], asked: Asked) -> NDArray[np.float64]:
    return np.array([[value(row, metric) for row in rows] for metric in (asked.by, asked.against)])
