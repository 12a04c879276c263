"""How each metric of a sweep is spread: a histogram per metric, by drive."""

from pathlib import Path

import numpy as np

from twin.studies.figure import BARE, INK, picture
from twin.studies.sweep.folder import KeptRows
from twin.studies.sweep.show.front import COLORS
from twin.studies.sweep.statistics.distribution import spread
from twin.studies.sweep.statistics.ranking import drives_in, metrics_in, of_drive, value

COLUMNS = 3


def draw_spreads(kept: KeptRows, path: Path) -> None:
    """Write the picture to `path` (PNG).

    Raises:
        NotWritten: the disk refuses.
    """
    columns = kept.columns
    metrics, drives = metrics_in(columns), drives_in(columns)
    lines = -(-len(metrics) // COLUMNS)
    with picture(path, 11, 0.8 + 2.3 * lines, look=BARE) as figure:
        panels = figure.subplots(lines, COLUMNS, squeeze=False).ravel()
        for axes, metric in zip(panels, metrics, strict=False):
            found = spread(columns, metric)
            assert found is not None
            for number, drive in enumerate(drives):
                values = value(columns, metric)[of_drive(columns, drive)] if len(drives) > 1 else found.numbers
                counts, _ = np.histogram(values[~np.isnan(values)], len(found.counts), tuple(found.edges[[0, -1]]))
                # of a million runs only their counts
                axes.hist(
                    found.edges[:-1], found.edges, weights=counts, color=COLORS[number % len(COLORS)],
                    histtype="stepfilled" if len(drives) == 1 else "step", lw=1.6, label=drive,
                )  # fmt: skip
            axes.axvline(found.quantiles[2], color=INK, lw=1.0, ls="--")
            axes.set(xlabel=metric + (f" ({found.missing} runs have none)" if found.missing else ""), ylabel="runs")
            axes.tick_params(labelsize=8)
        for axes in panels[len(metrics) :]:
            axes.set_visible(False)
        if len(drives) > 1:
            handles, labels = panels[0].get_legend_handles_labels()
            figure.legend(handles, labels, loc="outside lower center", ncols=min(5, len(drives)))
        figure.suptitle(f"{kept.name}: {len(columns)} runs; dashed: median", x=0.01, ha="left", fontsize=10)
