"""Fig. 4 as bands: what the curves come to when the plant is not what the controller believes."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes

from twin.studies.figure import picture
from twin.studies.paper.fig4_picture import FP_BASED, FP_REFERENCE, P_BASED
from twin.studies.sweep.folder import KeptRows
from twin.studies.sweep.statistics.bands import Bands

PANELS = (
    ("A", "z", "z position, estimated (mm)", 1e3),
    ("B", "F_z", "F_z, pressing, estimated (N)", 1.0),
    ("C", "F_x", "F_x, estimated (N)", 1.0),
    ("D", "F_y", "F_y, estimated (N)", 1.0),
    ("E", "true_z", "z position, true, close up (mm)", 1e3),
    ("F", "true_F_z", "F_z, pressing, true (N)", 1.0),
)
RUNS = (("position", P_BASED, "P-based"), ("force_position", FP_BASED, "F&P-based"))
"""The force-position run on top, as in the paper."""
SETTLED = 8.0
"""Since when (s) the height changes by so little that E shows it larger."""
MARGIN = 0.1
"""Around it (mm)."""


def draw_bands(bands: Bands, kept: KeptRows, path: Path) -> None:
    """Write the picture to `path` (PNG): panels A to D of Fig. 4, and below them what is true.

    Raises:
        NotWritten: the disk refuses.
    """
    with picture(path, 12, 10.5) as figure:
        panels = figure.subplots(3, 2, sharex=True)
        for axes, (letter, name, label, scale) in zip(panels.ravel(), PANELS, strict=True):
            if letter == "A":
                _draw(axes, bands, "force_position.z_cmd", scale, FP_REFERENCE, "F&P-based-ref")
            for run, color, who in RUNS:
                _draw(axes, bands, f"{run}.{name}", scale, color, who)
            axes.set_ylabel(label)
            axes.set_title(letter, loc="left", fontweight="bold")
            axes.legend()
            axes.set_xlim(0, 20)
        for pair in ((panels[1, 0], panels[1, 1]), (panels[0, 1], panels[2, 1])):
            limits = [axes.get_ylim() for axes in pair]
            for axes in pair:
                axes.set_ylim(min(low for low, _ in limits), max(high for _, high in limits))
        settled = bands.t >= SETTLED
        z = [1e3 * bands[f"{run}.true_z"][:, settled] for run, _, _ in RUNS]
        panels[2, 0].set_ylim(min(map(np.min, z)) - MARGIN, max(map(np.max, z)) + MARGIN)
        for axes in panels[2]:
            axes.set_xlabel("time (s)")
        figure.suptitle(
            f"{kept.name}: {bands.runs} of {kept.runs} runs; line: median, dark: 25 to 75 %, light: 5 to 95 %",
            x=0.01, ha="left", fontsize=11,
        )  # fmt: skip


def _draw(axes: Axes, bands: Bands, name: str, scale: float, color: str, label: str) -> None:
    least, low, median, high, most = scale * bands[name]
    axes.fill_between(bands.t, least, most, color=color, alpha=0.18, lw=0)
    axes.fill_between(bands.t, low, high, color=color, alpha=0.35, lw=0)
    axes.plot(bands.t, median, color=color, lw=1.4, label=label)
