"""A picture of how metrics are spread."""

import math
from pathlib import Path

from tests.studies.sweep.statistics.rows import kept, row
from twin.studies.sweep.show.spread import draw_spreads


def test_metrics_that_differ_by_a_rounding_or_not_at_all_are_drawn(tmp_path: Path):
    near = math.nextafter(1000.0, math.inf)
    rows = [row(n, {}, peak_N=peak, constant=1e-9, usual=float(n)) for n, peak in enumerate((1000.0, near, 1000.0))]
    draw_spreads(kept(rows), tmp_path / "spread.png")
    assert (tmp_path / "spread.png").read_bytes().startswith(b"\x89PNG")
