import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.colors import to_rgb
from matplotlib.image import imread

from tests.studies.sweep.statistics.rows import kept, row
from twin.studies.sweep.show.pictures import (
    FAILED_COLOR,
    MAX_DOTS,
    MAX_NUMBERED_CELLS,
    _levels,
    draw_spreads,
    draw_sweep,
    visible_dots,
)


def test_of_few_dots_all_are_drawn():
    x = np.zeros(MAX_DOTS)
    assert visible_dots(x, x, 1).tolist() == list(range(MAX_DOTS))


@pytest.mark.parametrize("most", [1, 4])
def test_of_a_crowd_the_last_ones_of_each_place_are_drawn_in_their_order(most: int):
    x, y = np.random.default_rng(0).integers(10, size=(2, MAX_DOTS + 1)).astype(float)
    drawn = visible_dots(x, y, most)
    expected = [np.flatnonzero((x == i) & (y == j))[-most:] for i in range(10) for j in range(10)]
    assert drawn.tolist() == sorted(np.concatenate(expected))


def test_a_dot_that_is_not_drawn_has_one_after_it_that_is_less_than_a_cell_away():
    x, y = np.random.default_rng(1).normal(size=(2, MAX_DOTS + 1000))
    drawn = visible_dots(x, y, 1)
    hidden = np.setdiff1d(np.arange(len(x)), drawn)[::500]
    cell = [np.ptp(along) / 150 for along in (x, y)]
    for dot in hidden:
        after = drawn[drawn > dot]
        assert ((abs(x[after] - x[dot]) < cell[0]) & (abs(y[after] - y[dot]) < cell[1])).any()


def test_dots_that_all_lie_in_one_place_are_no_crowd_to_divide_by():
    assert visible_dots(np.ones(MAX_DOTS + 5), np.ones(MAX_DOTS + 5), 2).tolist() == [MAX_DOTS + 3, MAX_DOTS + 4]


def test_of_a_grid_with_many_cells_those_that_failed_have_the_colour_of_failures(tmp_path: Path):
    many = 60
    assert many**2 > MAX_NUMBERED_CELLS
    rows = [
        row(1 + i * many + j, {"a": float(i), "b": float(j)}, None, "done", **({} if i < many // 4 else {"y": 1.0 + j}))
        for i in range(many)
        for j in range(many)
    ]
    draw_sweep(kept(rows), ("a", "b"), "y", tmp_path / "map.png")
    drawn = imread(tmp_path / "map.png")[..., :3]
    failed = np.flatnonzero((np.abs(drawn - to_rgb(FAILED_COLOR)).max(axis=-1) < 0.02).mean(axis=0) > 0.5)
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


def test_metrics_that_differ_by_a_rounding_or_not_at_all_are_drawn(tmp_path: Path):
    near = math.nextafter(1000.0, math.inf)
    rows = [row(n, {}, peak_N=peak, constant=1e-9, usual=float(n)) for n, peak in enumerate((1000.0, near, 1000.0))]
    draw_spreads(kept(rows), tmp_path / "spread.png")
    assert (tmp_path / "spread.png").read_bytes().startswith(b"\x89PNG")
