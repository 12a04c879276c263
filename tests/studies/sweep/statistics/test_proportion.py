"""Wilson's interval of a probability."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest

from twin.studies.sweep.statistics.proportion import wilson_interval


@given(st.integers(1, 500).flatmap(lambda n: st.tuples(st.integers(0, n), st.just(n))))
def test_it_is_scipys(counts: tuple[int, int]):
    expected = binomtest(*counts).proportion_ci(0.95, "wilson")
    # the same formula: rounding
    assert wilson_interval(*counts) == pytest.approx((expected.low, expected.high), abs=1e-12)


def test_all_of_a_few_runs_are_no_certainty_and_no_runs_say_nothing():
    # 20 of 20: Wilson's lower end is 1 / (1 + 1.96^2 / 20)
    assert wilson_interval(20, 20) == pytest.approx((0.839, 1.0), abs=5e-4)
    assert wilson_interval(0, 0) == (0.0, 1.0)
