"""A map of more cells than numbers could be read in shows colours only, failures among them."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from tests.studies.sweep.statistics.rows import kept, row
from twin.studies.sweep.show.picture import FAILED, MOST_NUMBERS, _levels, draw_sweep


def test_of_a_grid_with_many_cells_those_that_failed_have_the_colour_of_failures(tmp_path: Path):
    many = 60
    assert many**2 > MOST_NUMBERS
    rows = [
        row(1 + i * many + j, {"a": float(i), "b": float(j)}, None, "done", **({} if i < many // 4 else {"y": 1.0 + j}))
        for i in range(many)
        for j in range(many)
    ]
    draw_sweep(kept(rows), ("a", "b"), "y", tmp_path / "map.png")
    drawn = imread(tmp_path / "map.png")[..., :3]
    failed = np.flatnonzero((np.abs(drawn - to_rgb(FAILED)).max(axis=-1) < 0.02).mean(axis=0) > 0.5)
    # the map is where most of a column of pixels is neither white nor ink; the scale beside it comes after a gap
    coloured = np.flatnonzero((np.ptp(drawn, axis=-1) > 0.1).mean(axis=0) > 0.5)
    width = coloured[np.argmax(np.diff(coloured, append=10**6) > 5)] - coloured[0] + 1
    # a quarter of the map, at its left; both ends are known to a pixel
    assert len(failed) == np.ptp(failed) + 1 == pytest.approx(width / 4, abs=2)
    assert failed[0] == pytest.approx(coloured[0], abs=1)


@given(st.lists(st.tuples(st.integers(0, 4), st.integers(0, 4)), max_size=60))
def test_dots_are_those_of_a_grid_if_there_are_as_many_as_cells(dots: list[tuple[int, int]]):
    x, y = np.array(dots, float).reshape(-1, 2).T
    levels = sorted({*x}), sorted({*y})
    found = _levels(x, y)
    if 0 < len(levels[0]) * len(levels[1]) <= len(dots):
        assert found is not None and [level.tolist() for level in found] == list(levels)
    else:
        assert found is None
