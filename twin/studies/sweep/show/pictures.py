"""The pictures of a sweep, each where there is something to draw."""

from pathlib import Path

from twin.studies.sweep.folder import KeptRows
from twin.studies.sweep.show.axes import axes_of
from twin.studies.sweep.show.front import draw_front
from twin.studies.sweep.show.parts import Asked
from twin.studies.sweep.show.picture import draw_sweep
from twin.studies.sweep.show.spread import draw_spreads
from twin.studies.sweep.statistics.bands import bands
from twin.studies.sweep.statistics.pareto import pareto_front
from twin.studies.sweep.statistics.ranking import metrics_in


def write_pictures(kept: KeptRows, asked: Asked, x: str | None, y: str | None, folder: Path) -> dict[str, Path]:
    """Write them into `folder` (PNG), which exists: what each shows -> its file.

    Args:
        x, y: parameters of the heat map; None: the first two.

    Raises:
        InputRefused: x or y does not vary, or a file cannot be written.
    """
    files: dict[str, Path] = {}
    axes = axes_of(kept, x, y)
    # curves are in no column
    found = bands(kept.rows) if True in kept.columns.words("has_curves").counts else None
    if found:
        # takes a while to import, and few sweeps judge claims
        from twin.studies.sweep.show.bands import draw_bands

        files["bands"] = folder / "bands.png"
        draw_bands(found, kept, files["bands"])
    # in a sweep with claims nothing that varies is anyone's choice, so there is no best place on a map
    if axes and (not found or x or y):
        files["map"] = folder / "map.png"
        draw_sweep(kept, axes, asked.by, files["map"])
    if not found and len(pareto_front(kept.columns, asked.by, asked.against)) > 1:
        files["front"] = folder / "front.png"
        draw_front(kept, asked, files["front"])
    if len(kept.columns) > 1 and metrics_in(kept.columns):
        files["metrics"] = folder / "metrics.png"
        draw_spreads(kept, files["metrics"])
    return files
