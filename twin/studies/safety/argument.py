"""Picture of the safety argument in goal structuring notation: goals, strategies, evidence, assumptions.

GSN Community Standard Version 3 (2021): a goal is a rectangle, a strategy a parallelogram, a solution a circle, a
context a rounded rectangle, an assumption an ellipse; a goal that is not reached has a diamond below it.
"""

import textwrap
from collections.abc import Sequence
from pathlib import Path

from twin.studies.figure import BARE_STYLE, GREEN, GREY, INK, RED, Axes, picture
from twin.studies.safety.evidence import GOOD_STATUSES, HazardLine
from twin.studies.safety.hazards import SafetyTable

LOCAL_WIDTH, BOX_STEP = 2.6, 2.8
"""Width of a box and distance of neighbouring boxes (inches)."""
ROW_HEIGHT, BOXES_PER_ROW = 4.5, 4
"""Height of a row of goals (inches) and number of goals in it, legible on a printed page."""
FONT_SIZE = 10.0


def draw_argument(table: SafetyTable, lines: Sequence[HazardLine], path: Path) -> None:
    """Draw the safety argument to `path`: its goal, a goal for each line, and the runs behind each."""
    from matplotlib.patches import Circle, FancyBboxPatch, Polygon, Rectangle

    rows = -(-len(lines) // BOXES_PER_ROW)
    across, high = BOX_STEP * BOXES_PER_ROW, 2.6 + ROW_HEIGHT * rows
    with picture(path, across + 0.35, high + 0.2, look=BARE_STYLE) as figure:
        axes = figure.subplots()
        axes.set(xlim=(0, across + 0.15), ylim=(0, high), aspect="equal")
        axes.axis("off")
        middle = 0.3 * across
        axes.add_patch(Rectangle((0.2, high - 1.1), 2 * (middle - 0.2), 1.0, fc="white", ec=INK))
        _write_text(axes, middle, high - 0.6, f"G0: {table.head.title}: no hazard of the table exceeds its limit", 44)
        context = (2 * middle + 0.35, high - 1.1), across - 2 * middle - 0.5, 1.0
        axes.add_patch(FancyBboxPatch(*context, boxstyle="round,pad=0.05", fc="white", ec=GREY))
        _write_text(axes, middle + 0.5 * across, high - 0.6, f"C0: {table.head.experiment}; {table.head.use}", 44)
        slant = [(0.6, high - 2.1), (2 * middle - 0.6, high - 2.1), (2 * middle, high - 1.5), (1.2, high - 1.5)]
        axes.add_patch(Polygon(slant, fc="white", ec=INK))
        _write_text(axes, middle, high - 1.8, "S0: each hazard by all its causes, run in simulation", 60)
        _arrow(axes, middle, high - 1.1, middle, high - 1.5)
        # a line along the left edge branches to each row
        down = high - 2.55 - ROW_HEIGHT * (rows - 1)
        axes.plot([middle, middle, 0.05, 0.05], [high - 2.1, high - 2.3, high - 2.3, down], color=INK, lw=0.8)
        for number, line in enumerate(lines):
            row, column = divmod(number, BOXES_PER_ROW)
            x, top = BOX_STEP * (column + 0.5) + 0.1, high - 2.85 - ROW_HEIGHT * row
            good = line.status in GOOD_STATUSES
            color = GREEN if good else RED
            axes.plot([0.05, x], [top + 0.3, top + 0.3], color=INK, lw=0.8)
            _arrow(axes, x, top + 0.3, x, top)
            axes.add_patch(
                Rectangle((x - 0.5 * LOCAL_WIDTH, top - 1.3), LOCAL_WIDTH, 1.3, fc="white", ec=color, lw=1.6)
            )
            text = f"{line.hazard.table.id}: {line.hazard.table.hazard}: {line.hazard.limit_text}"
            _write_text(axes, x, top - 0.65, text, 28)
            _arrow(axes, x, top - 1.3, x, top - 1.7)
            axes.add_patch(Circle((x, top - 2.6), 0.9, fc="white", ec=color, lw=1.6))
            _write_text(axes, x, top - 2.6, f"{len(line.runs) + len(line.distances)} runs\n{line.status}", 14)
            if not good:
                diamond = [(x, top - 3.5), (x + 0.2, top - 3.7), (x, top - 3.9), (x - 0.2, top - 3.7)]
                axes.add_patch(Polygon(diamond, fc="white", ec=RED))


def _write_text(axes: Axes, x: float, y: float, text: str, columns: int) -> None:
    lines = [part for line in text.split("\n") for part in textwrap.wrap(line, columns)]
    axes.text(x, y, "\n".join(lines[:5]), ha="center", va="center", fontsize=FONT_SIZE)


def _arrow(axes: Axes, x: float, y: float, to_x: float, to_y: float) -> None:
    axes.annotate("", (to_x, to_y), (x, y), arrowprops={"arrowstyle": "-|>", "color": INK, "lw": 0.8})
