"""Picture of a comparison of two logs."""

from pathlib import Path

import numpy as np

from twin.kernel.recording.logs.log import sampling
from twin.studies.compare.comparison import Comparison
from twin.studies.compare.signal_row import SignalRow, TubeCurves
from twin.studies.compare.text import display_unit
from twin.studies.figure import PAPER_BLUE, PAPER_ORANGE, Axes, picture
from twin.studies.metrics.response import rms
from twin.studies.result import join_names

MAX_CURVES = 6
SAME_CURVE_SHARE = 0.02
"""Maximum rms difference, as a share of the range, of curves that look the same: low-pass filters, display steps."""
MAX_NAMED = 2
A_COLOUR, B_COLOUR, OUT_COLOUR = PAPER_BLUE, PAPER_ORANGE, "#b3261e"


def draw_comparison(comparison: Comparison, path: Path) -> None:
    """Draw the worst signals to `path` (PNG), at most `MAX_CURVES`, each of several equal signals once."""
    rows = distinct_signals(comparison)[:MAX_CURVES]
    columns = 1 if len(rows) == 1 else 2
    deep = -(-len(rows) // columns)
    with picture(path, 6.6 * columns, 3.2 * deep + 0.4) as figure:
        grid = figure.add_gridspec(2 * deep, columns, height_ratios=[3, 1] * deep)
        for place, (row, alike) in enumerate(rows):
            line, column = divmod(place, columns)
            above = figure.add_subplot(grid[2 * line, column])
            below = figure.add_subplot(grid[2 * line + 1, column], sharex=above)
            _draw(above, below, row, comparison.curves[row.signal])
            if alike:
                above.set_title(f"as {join_names(alike, MAX_NAMED)}", loc="right", fontsize=8)
        handles, names = figure.axes[0].get_legend_handles_labels()
        files = {"A": f"A  {_tail(comparison.a)}", "B": f"B  {_tail(comparison.b)}"}
        names = [files.get(name, name) for name in names]
        figure.legend(handles, names, loc="outside upper center", ncols=2, fontsize=9)


def distinct_signals(comparison: Comparison) -> list[tuple[SignalRow, list[str]]]:
    """Group compared signals, worst first, with later ones that look the same: one force has many names."""
    found: list[tuple[SignalRow, list[str]]] = []
    for row in comparison.rows:
        first = next((one for one in found[:MAX_CURVES] if _same(comparison, one[0], row)), None)
        if first is None:
            found.append((row, []))
        else:
            first[1].append(row.signal)
    return found


def _same(comparison: Comparison, one: SignalRow, other: SignalRow) -> bool:
    """Whether two signals look the same in both logs, up to the sign and a small share of their range."""
    if one.unit != other.unit:
        return False
    here, there = comparison.curves[one.signal], comparison.curves[other.signal]
    span = max(np.ptp(here.a), np.ptp(here.b))
    pairs = [(x, np.interp(here.t, there.t, y)) for x, y in ((here.a, there.a), (here.b, there.b))]
    return any(all(rms(x - sign * y) <= SAME_CURVE_SHARE * span for x, y in pairs) for sign in (1.0, -1.0))


def _draw(above: Axes, below: Axes, row: SignalRow, curves: TubeCurves) -> None:
    unit, factor = display_unit(row.unit)
    t, apart = _with_breaks(curves.t)
    a, b, lower, upper = (factor * np.insert(values, apart, np.nan) for values in (curves.a, curves.b, *curves.tube))
    excess = np.insert(curves.tube.excess(curves.b), apart, 0.0)
    marker = "." if len(t) < 200 else ""
    above.fill_between(t, lower, upper, color=A_COLOUR, alpha=0.25, lw=0, label="tolerance tube")
    above.plot(t, a, color=A_COLOUR, lw=1.6, label="A")
    above.plot(t, b, color=B_COLOUR, lw=1.0, marker=marker, label="B")
    verdict = "inside"
    if row.first_exit:
        out = row.first_exit
        above.plot(out.t, factor * out.value, "o", mfc="none", color=OUT_COLOUR, ms=9, label="first out of the tube")
        verdict = f"out from {out.t:.6g} s"
    above.set_title(f"{row.signal}: {verdict}", loc="left", fontsize=10)
    above.set_ylabel(unit or "1")
    below.axhline(0.0, color=A_COLOUR, lw=1.0)
    below.plot(t, b - a, color=B_COLOUR, lw=0.9)
    below.plot(t, np.where(excess != 0.0, b - a, np.nan), color=OUT_COLOUR, lw=1.6)
    below.set(xlabel="time (s)", ylabel="B - A")
    above.tick_params(labelbottom=False)


def _tail(path: Path) -> str:
    """Return the last three parts of a path, which distinguish files in a picture."""
    return "/".join(path.parts[-3:])


def _with_breaks(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Insert a time into each gap of a log's times, to break drawn lines; return times and inserted indices."""
    gaps = sampling(t).gaps if len(t) > 1 else np.empty((0, 2))
    apart = np.searchsorted(t, gaps[:, 1])
    return np.insert(t, apart, gaps.mean(axis=1)), apart
