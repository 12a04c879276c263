"""Sums over a block of rows."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from twin.robot.plant.deviation import COLUMN_COUNT, DeviationSums

WIDTH = 12


@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 40), exponent=st.integers(-150, 150))
def test_sums_are_those_of_the_rows_in_their_order_to_the_last_bit(seed: int, count: int, exponent: int):
    rng = np.random.default_rng(seed)
    rows = rng.normal(size=(count, WIDTH)) * 10.0**exponent
    columns = rng.permutation(WIDTH)[:COLUMN_COUNT]
    F_z, p_B, p_ref_B, on, F_z_ref = np.split(rows[:, columns].T, [1, 4, 7, 8])
    block = DeviationSums(40)
    touched = bool(seed % 2)
    block.add_block(rows, columns, touched)
    assert (block.squares == np.cumsum(np.square(p_B - p_ref_B), axis=1)[:, -1]).all()
    pressed = np.logical_or.accumulate(F_z[0] < 0.0)
    controlled = (on[0] > 0.0) & (touched | pressed)
    assert (block.off == np.square(F_z_ref[0] + F_z[0])[controlled]).all() and len(block.off) == controlled.sum()
    assert (block.peak, block.place) == (np.max(-F_z), np.argmax(-F_z))
    first = [int(np.argmax(there)) if there.any() else -1 for there in (F_z[0] < 0.0, on[0] > 0.0)]
    assert [block.touch, block.trigger] == first


def test_of_two_equal_peaks_the_first_counts():
    rows = np.zeros((5, COLUMN_COUNT))
    rows[[1, 3], 0] = -2.0
    block = DeviationSums(5)
    block.add_block(rows, np.arange(COLUMN_COUNT))
    assert (block.peak, block.place) == (2.0, 1)


def test_what_is_nowhere_in_the_rows_is_not_a_number():
    columns = np.arange(COLUMN_COUNT)
    columns[4:7] = -1
    block = DeviationSums(5)
    block.add_block(np.ones((5, COLUMN_COUNT)), columns, touched=True)
    assert np.isnan(block.squares).all() and block.off.tolist() == [4.0] * 5
    columns[7] = -1
    block.add_block(np.ones((5, COLUMN_COUNT)), columns, touched=True)
    assert len(block.off) == 0
