"""Pictures of a run for the page: the panels of a report, limited to the visible span and the screen's resolution."""

import math
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

import numpy as np

from twin.kernel.compiled.function import carray
from twin.kernel.compiled.native import entry
from twin.report.page.markup import DataBlock
from twin.report.page.panels import (
    MM,
    RUN_PANELS,
    PanelRun,
    panel_facts,
    row_facts,
    series,
)
from twin.robot.run.measures import ROWS_BY_KEY, RunOutcome
from twin.robot.run.outcome import HeldForces
from twin.studies.metrics.response import Curve
from twin.studies.panel import Panel, PanelCurve, Reader, Samples

CORRECTION_PANEL = Panel(
    "Correction of the force loop", "mm",
    (PanelCurve("dp_z, below 0 presses harder", "shifted", series("controller.dp_z", None, MM)),),
)  # fmt: skip
EXPLORED_PANELS = (*RUN_PANELS[:2], CORRECTION_PANEL, *RUN_PANELS[2:])
"""All available panels, in display order."""
INITIAL_PANELS = (
    "Pressing force F_z", "Height z", "Correction of the force loop", "Force along x, y on the surface",
    "Joint torque tau_l", "Motor speed",
)  # fmt: skip
MAX_POSES = 600
"""Maximum number of poses of the robot; the player interpolates between them."""
TILE_MEASURES = (
    "hold_error", "hold_overshoot", "hold_settling_time", "chatter", "held_lateral_error", "peak", "held_z_error",
    "torque", "force_error", "end", "lateral_error", "z_error",
)  # fmt: skip
"""Measures above the plots, in display order."""


def shown_panels(run: PanelRun) -> list[str]:
    """Return the titles of the panels with data of the run."""
    return [panel.title for panel in EXPLORED_PANELS if any(quantity.read(run) for quantity in panel.quantities)]


def panels_to_json(
    panels: Iterable[Panel], run: Any, block: DataBlock, span: tuple[float, float], width: int
) -> list[dict[str, Any]]:
    """Convert panels of curves to JSON-serialisable values; their samples are appended to `block`.

    Each of `width` parts (pixels) of `span` (begin and end, s) keeps its extremes, so no spike is lost. Samples beyond
    the span stay coarse.
    """
    return [
        panel_facts(
            panel,
            [
                row_facts(quantity) | {"curve": _curve(quantity.read, run, block, span, width)}
                for quantity in panel.quantities
            ],
        )
        for panel in panels
    ]


def _curve(read: Reader, run: Any, block: DataBlock, span: tuple[float, float], width: int) -> list[float] | None:
    """Append a curve's samples to the block; return [index of its first, count, first time (s), step (s)], or None."""
    samples = read(run)
    if samples is None or not len(samples[0]):
        return None
    t, values, step = _clip_samples(samples, span)
    factor = max(1, math.ceil(len(values) / (2 * width)))
    return [*block.add(extremes(values, 2 * factor)), float(t[0]), step * factor]


def _clip_samples(samples: Samples, span: tuple[float, float]) -> tuple[Curve, Curve, float]:
    """Return the (times, values, time step (s)) of a curve in slightly more than `span`."""
    t, values = samples
    step = float(t[-1] - t[0]) / max(1, len(t) - 1)
    if not step:
        return t, values, 1.0
    first = min(len(t) - 1, max(0, math.floor((span[0] - t[0]) / step) - 1))
    last = max(first + 1, min(len(t), math.ceil((span[1] - t[0]) / step) + 2))
    return t[first:last], values[first:last], step


@entry("int", "doubles", "int", "int", "doubles")
def _extremes(values, count, width, found):
    y, pairs = carray(values, count), carray(found, 2 * ((count + width - 1) // width))
    place = 0
    for first in range(0, count, width):
        low = high = first
        for i in range(first + 1, min(first + width, count)):
            # a NaN is replaced by the other value
            if y[i] < y[low] or y[low] != y[low]:
                low = i
            if y[i] > y[high] or y[high] != y[high]:
                high = i
        pairs[place], pairs[place + 1] = y[min(low, high)], y[max(low, high)]
        place += 2
    return place


def extremes(values: Curve, width: int) -> Curve:
    """Return the minimum and maximum of each `width` values of `values` (n,), in order; all values for a width of 2."""
    if width <= 2:
        return values
    y = np.ascontiguousarray(values, dtype=np.float64)
    found = np.empty(2 * math.ceil(len(y) / width))
    _extremes(y, len(y), width, found)
    return found


class Tile(NamedTuple):
    """A number above the explorer's plots, in `unit` with `digits` after the decimal point, and a sentence on it.

    `reason` is why it is missing (None), or a remark on it.
    """

    name: str
    unit: str
    value: float | None
    reason: str = ""
    digits: int = 2
    meaning: str = ""


def tiles(outcome: RunOutcome, held: Sequence[HeldForces]) -> list[Tile]:
    """Return the numbers displayed above the explorer's plots: measures of the run, and each task's force range."""
    found = []
    for measure in (ROWS_BY_KEY[key] for key in TILE_MEASURES):
        value, reason = (one := outcome.measures[measure.key]).value, one.reason
        shown = None if value is None else value * measure.unit.per_SI
        meaning = f"{measure.meaning}: {measure.interval}"
        found.append(Tile(measure.text, measure.unit.text, shown, reason, measure.digits, meaning))
    for task in held:
        for name, force in (("least", task.least), ("largest", task.largest)):
            found.append(
                Tile(f"task {task.task}, {task.kind}: {name} force", "N", force, "never held" * (force is None))
            )
    return found
