"""What trades off in a sweep: every run over two metrics, the front that no run beats, failures counted."""

from pathlib import Path

from twin.studies.figure import BLUE, GREEN, INK, ORANGE, PINK, SKY, VERMILION, picture
from twin.studies.lines import counted
from twin.studies.sweep.columns import Columns, Numbers, Positions
from twin.studies.sweep.folder import KeptRows
from twin.studies.sweep.show.crowd import visible
from twin.studies.sweep.show.parts import Asked
from twin.studies.sweep.statistics.pareto import pareto_front
from twin.studies.sweep.statistics.ranking import best, drives_in, of_drive, value

COLORS = (BLUE, VERMILION, GREEN, PINK, ORANGE, SKY, "#000000")
MARKERS = "osD^vP*X"
DEEP = 4
"""Dots of a crowd on top of each other that are drawn: beneath so many nothing shines through."""
FINE = 1000
"""Cells of the front of a crowd, which is a line: smaller than a pixel."""


def draw_front(kept: KeptRows, asked: Asked, path: Path) -> None:
    """Write the picture to `path` (PNG).

    Raises:
        NotWritten: the disk refuses.
    """
    with picture(path, 7.5, 4.8) as figure:
        axes = figure.subplots()
        columns = kept.columns
        ranked = best(columns, asked.by)
        for number, drive in enumerate(drives_in(columns)):
            mine = ranked[of_drive(columns, drive)[ranked]]
            x, y = _points(columns, mine, asked)
            drawn = visible(x, y, DEEP)
            axes.scatter(
                x[drawn], y[drawn], s=26, color=COLORS[number % len(COLORS)], marker=MARKERS[number % len(MARKERS)],
                alpha=0.75, lw=0, label=f"{drive or 'runs'} ({len(mine)})",
            )  # fmt: skip
        x, y = _points(columns, pareto_front(columns, asked.by, asked.against), asked)
        drawn = visible(x, y, 1, FINE)
        x, y = x[drawn], y[drawn]
        axes.step(x, y, where="post", color=INK, lw=1.2, label="Pareto front")
        axes.scatter(x, y, s=70, facecolors="none", edgecolors=INK, lw=1.2)
        axes.set(xlabel=f"{asked.by} (less is better)", ylabel=f"{asked.against} (less is better)")
        axes.legend()
        absent = len(columns) - len(ranked)
        text = f"; {counted(absent, 'run')} not shown: failed, tripped or beyond the limits" if absent else ""
        figure.suptitle(f"{kept.name}: {len(ranked)} of {kept.runs} runs{text}", x=0.01, ha="left", fontsize=10)


def _points(columns: Columns, rows: Positions, asked: Asked) -> tuple[Numbers, Numbers]:
    return value(columns, asked.by)[rows], value(columns, asked.against)[rows]
