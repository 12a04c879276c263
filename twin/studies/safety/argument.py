"""The argument for safety as a picture of goals, strategies, evidence and what is assumed (goal structuring notation).

GSN Community Standard Version 3 (2021): a goal is a rectangle, a strategy a parallelogram, a solution a circle, a
context a rounded rectangle, an assumption an ellipse; a goal that is not reached has a diamond below it.
"""

import textwrap
from collections.abc import Sequence
from pathlib import Path

from twin.studies.figure import BARE, GREEN, GREY, INK, RED, Axes, picture
from twin.studies.safety.evidence import HazardLine
from twin.studies.safety.hazards import SafetyTable

WIDTH, STEP = 2.5, 2.8
"""Of a box, and from one to the next, in inches of the picture."""
LETTERS = 12.0


def draw_argument(table: SafetyTable, lines: Sequence[HazardLine], path: Path) -> None:
    """Write the picture to `path`: the goal of the whole table, one below it for each line, the runs behind each."""
    from matplotlib.patches import Circle, FancyBboxPatch, Polygon, Rectangle

    # the context beside the goal takes the room of six
    across = STEP * max(6, len(lines))
    with picture(path, across + 0.4, 7.4, look=BARE) as figure:
        axes = figure.subplots()
        axes.set(xlim=(0, across), ylim=(0, 7.2), aspect="equal")
        axes.axis("off")
        middle = 0.5 * across
        axes.add_patch(Rectangle((middle - 2.2, 6.1), 4.4, 0.9, fc="white", ec=INK))
        _say(axes, middle, 6.55, f"G0: {table.head.title}: no hazard of the table exceeds its limit", 40)
        axes.add_patch(FancyBboxPatch((middle + 2.6, 6.0), 5.2, 1.0, boxstyle="round,pad=0.05", fc="white", ec=GREY))
        _say(axes, middle + 5.2, 6.5, f"C0: {table.head.experiment}; {table.head.use}", 46)
        slant = [(middle - 1.9, 5.0), (middle + 1.7, 5.0), (middle + 1.9, 5.6), (middle - 1.7, 5.6)]
        axes.add_patch(Polygon(slant, fc="white", ec=INK))
        _say(axes, middle, 5.3, "S0: each hazard by all its causes, run in simulation", 34)
        _arrow(axes, middle, 6.1, middle, 5.6)
        for number, line in enumerate(lines):
            x = middle + STEP * (number + 0.5 - 0.5 * len(lines))
            good = line.status == "kept"
            color = GREEN if good else RED
            _arrow(axes, middle, 5.0, x, 4.3)
            axes.add_patch(Rectangle((x - 0.5 * WIDTH, 3.0), WIDTH, 1.3, fc="white", ec=color, lw=1.6))
            _say(axes, x, 3.65, f"{line.hazard.table.id}: {line.hazard.table.hazard}: {line.hazard.limit_text}", 24)
            _arrow(axes, x, 3.0, x, 2.4)
            axes.add_patch(Circle((x, 1.5), 0.9, fc="white", ec=color, lw=1.6))
            _say(axes, x, 1.5, f"{len(line.runs) + len(line.distances)} runs\n{line.status}", 14)
            if not good:
                diamond = [(x, 0.6), (x + 0.2, 0.4), (x, 0.2), (x - 0.2, 0.4)]
                axes.add_patch(Polygon(diamond, fc="white", ec=RED))


def _say(axes: Axes, x: float, y: float, text: str, columns: int) -> None:
    lines = [part for line in text.split("\n") for part in textwrap.wrap(line, columns)]
    axes.text(x, y, "\n".join(lines[:5]), ha="center", va="center", fontsize=LETTERS)


def _arrow(axes: Axes, x: float, y: float, to_x: float, to_y: float) -> None:
    axes.annotate("", (to_x, to_y), (x, y), arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 0.8})
