"""A value that is far out does not leave one colour to all the others, and the picture says so."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from twin.studies.sweep.show.picture import shown_range


def test_what_is_far_out_is_clipped_and_said():
    values = [1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 90.0]
    low, high, told = shown_range(np.array(values))
    assert (low, high) == (1.0, 1.5)
    assert told == "1 of 7 are far out, 1 to 90 in all: coloured as 1 or 1.5"


def test_what_is_merely_spread_is_shown_whole():
    assert shown_range(np.array([1.0, 2.0, 4.0, 8.0])) == (1.0, 8.0, "")
    assert shown_range(np.array([])) == (0.0, 1.0, "") and shown_range(np.array([2.0, 2.0, 2.0, 9.0])) == (2.0, 9.0, "")


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=40))
def test_the_range_lies_within_the_values_and_holds_at_least_half_of_them(values: list[float]):
    low, high, told = shown_range(np.array(values))
    assert min(values) <= low <= high <= max(values)
    assert 2 * sum(low <= value <= high for value in values) >= len(values)
    assert bool(told) == (low > min(values) or high < max(values))
