"""Of a crowd enough dots are drawn to hide those that are not, and of few all are."""

import numpy as np
import pytest

from twin.studies.sweep.show.crowd import CROWD, visible


def test_of_few_dots_all_are_drawn():
    x = np.zeros(CROWD)
    assert visible(x, x, 1).tolist() == list(range(CROWD))


@pytest.mark.parametrize("most", [1, 4])
def test_of_a_crowd_the_last_ones_of_each_place_are_drawn_in_their_order(most: int):
    x, y = np.random.default_rng(0).integers(10, size=(2, CROWD + 1)).astype(float)
    drawn = visible(x, y, most)
    expected = [np.flatnonzero((x == i) & (y == j))[-most:] for i in range(10) for j in range(10)]
    assert drawn.tolist() == sorted(np.concatenate(expected))


def test_a_dot_that_is_not_drawn_has_one_after_it_that_is_less_than_a_cell_away():
    x, y = np.random.default_rng(1).normal(size=(2, CROWD + 1000))
    drawn = visible(x, y, 1)
    hidden = np.setdiff1d(np.arange(len(x)), drawn)[::500]
    cell = [np.ptp(along) / 150 for along in (x, y)]
    for dot in hidden:
        after = drawn[drawn > dot]
        assert ((abs(x[after] - x[dot]) < cell[0]) & (abs(y[after] - y[dot]) < cell[1])).any()


def test_dots_that_all_lie_in_one_place_are_no_crowd_to_divide_by():
    assert visible(np.ones(CROWD + 5), np.ones(CROWD + 5), 2).tolist() == [CROWD + 3, CROWD + 4]
