"""The matrix of faults as one picture: with the monitor beside without."""

from collections.abc import Sequence
from itertools import groupby
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from twin.experiment.fault_catalogue import CATALOGUE
from twin.studies.faults.row import ALLOWANCE, FaultRow
from twin.studies.faults.text import magnitude_text
from twin.studies.figure import BARE, INK, LESS_IS_BETTER, LIGHT_IS_GOOD, VERMILION, picture

BEYOND = VERMILION
DARKEST = 2.0
"""Peak over limit at which the colours end."""
SIZES = 3
"""Magnitudes of a kind; a kind that has none takes the room of all."""


def draw_fault_matrix(experiment: str, rows: Sequence[FaultRow], path: Path) -> None:
    """Write the picture to `path` (PNG): a line per kind, a column per onset and magnitude, the peak force in each.

    Args:
        experiment: its name.
        rows: of one matrix, kind by kind, the same onsets for each.
    """
    kinds = [list(group) for _, group in groupby(rows, lambda row: row.kind)]
    onsets = list(dict.fromkeys(row.onset for row in rows))
    title = f"Faults in {experiment}: largest true contact force (N) from the onset on; limit {rows[0].limit:g} N"
    with picture(path, 5.0 + 2.8 * len(onsets), 2.2 + 0.31 * len(kinds), title, look=BARE) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        shade = ScalarMappable(Normalize(0.0, DARKEST), LESS_IS_BETTER)
        for axes, watched in zip(panels, (True, False), strict=True):
            for line, of_kind in enumerate(kinds):
                for row in of_kind:
                    _draw_cell(axes, shade, row, watched, line, onsets.index(row.onset))
            _label(axes, rows, onsets, len(kinds))
            axes.set_title("with monitor" if watched else "without monitor", fontweight="bold", pad=22)
        panels[0].set_yticks(np.arange(len(kinds)) + 0.5, [_kind_text(of_kind) for of_kind in kinds], fontsize=8.5)
        label = f"largest true force / force limit {LIGHT_IS_GOOD}"
        figure.colorbar(shade, ax=panels, extend="max", shrink=0.6, pad=0.01, label=label)
        marks = [
            Line2D([], [], ls="", marker="o", color=INK, ms=4, label="seen by the monitor"),
            Line2D([], [], ls="", marker="x", color=INK, ms=5, label="run ended there: a component failed"),
            Rectangle((0, 0), 1, 1, fill=False, ec=BEYOND, lw=2.2, label=f"beyond {ALLOWANCE:g} of the limit"),
        ]
        figure.legend(handles=marks, loc="outside lower center", ncols=3)


def _draw_cell(axes: Axes, shade: ScalarMappable, row: FaultRow, watched: bool, line: int, onset: int) -> None:
    run, safe = (row.watched, row.safe) if watched else (row.unwatched, row.safe_unwatched)
    wide = SIZES if row.magnitude is None else 1
    left = onset * SIZES + (0 if row.magnitude is None else _size(row))
    r, g, b, _ = color = shade.to_rgba(np.array([run.peak / row.limit]))[0]
    axes.add_patch(Rectangle((left, line), wide, 1, fc=color, ec="white", lw=0.6))
    if not safe:
        axes.add_patch(
            Rectangle((left + 0.06, line + 0.08), wide - 0.12, 0.84, fill=False, ec=BEYOND, lw=2.2, zorder=3)
        )
    ink = INK if 0.299 * r + 0.587 * g + 0.114 * b > 0.5 else "white"
    middle = left + 0.5 * wide
    axes.text(middle - 0.1, line + 0.52, f"{run.peak:.1f}", color=ink, ha="center", va="center", fontsize=7.5)
    if run.end == "run ended":
        axes.plot(middle + 0.36, line + 0.5, ls="", marker="x", color=ink, ms=4.5)
    elif run.reason:
        axes.plot(middle + 0.36, line + 0.5, ls="", marker="o", color=ink, ms=3.5)


def _size(row: FaultRow) -> int:
    """Which of the kind's magnitudes it is, from 0."""
    return (CATALOGUE[row.kind].magnitudes or ()).index(row.magnitude or 0.0)


def _kind_text(of_kind: Sequence[FaultRow]) -> str:
    sizes = list(dict.fromkeys(row.magnitude for row in of_kind))
    if sizes == [None]:
        return of_kind[0].kind
    *smaller, largest = sizes
    return f"{of_kind[0].kind}  " + ", ".join([f"{m:g}" for m in smaller] + [magnitude_text(of_kind[0].kind, largest)])


def _label(axes: Axes, rows: Sequence[FaultRow], onsets: Sequence[float], lines: int) -> None:
    in_contact = {row.onset: row.in_contact for row in rows}
    axes.set_xlim(0, SIZES * len(onsets))
    axes.set_ylim(lines, 0)
    axes.set_xticks(np.arange(SIZES * len(onsets)) + 0.5, ["small", "medium", "large"] * len(onsets), fontsize=7.5)
    axes.tick_params(length=0, top=False)
    for i, onset in enumerate(onsets):
        text = f"onset {onset:.2f} s, {'in contact' if in_contact[onset] else 'free'}"
        axes.text(SIZES * (i + 0.5), -0.35, text, ha="center", va="bottom", fontsize=9)
        if i:
            axes.axvline(SIZES * i, color=INK, lw=1.6)
    for side in axes.spines.values():
        side.set_visible(False)
