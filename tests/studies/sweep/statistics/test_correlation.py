"""Rank correlation: scipy's numbers, intervals that hold the truth as often as they say."""

import math
from fractions import Fraction
from statistics import NormalDist

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import spearmanr

from tests.studies.sweep.statistics.rows import row
from twin.studies.sweep.columns import columns_of
from twin.studies.sweep.show.sensitivity import starred
from twin.studies.sweep.statistics.correlation import Correlation, rank_correlation

NUMBERS = st.lists(st.tuples(st.integers(-5, 5), st.integers(-5, 5)), min_size=4, max_size=40)


def rows_of(pairs) -> list:
    return [row(number, {"a": float(x)}, y=float(y)) for number, (x, y) in enumerate(pairs, start=1)]


@given(NUMBERS)
def test_rho_and_p_are_scipys_ties_included(pairs: list[tuple[int, int]]):
    found = rank_correlation(columns_of(rows_of(pairs)), "a", "y")
    x, y = np.array(pairs, float).T
    if np.ptp(x) == 0.0 or np.ptp(y) == 0.0:
        assert found is None
        return
    expected = spearmanr(x, y)
    assert found is not None and found.runs == len(pairs)
    # the same sums in another order: rounding
    assert found.rho == pytest.approx(expected.statistic, abs=1e-12)
    # near |rho| = 1 the rounding of 1 - rho^2 is all that p is made of
    assert found.p == pytest.approx(expected.pvalue, abs=1e-6)
    assert -1.0 <= found.low <= found.rho <= found.high <= 1.0


def test_any_rising_relation_is_a_perfect_correlation():
    found = rank_correlation(columns_of(rows_of([(x, np.exp(0.1 * x)) for x in range(10)])), "a", "y")
    assert found == Correlation(1.0, 1.0, 1.0, 0.0, 10)


def test_the_interval_holds_the_true_correlation_in_95_percent_of_samples():
    rng, true_rho, held = np.random.default_rng(0), 0.5, 0
    # Pearson's correlation of normal numbers whose rank correlation is 0.5 (Kruskal 1958)
    r = 2.0 * np.sin(np.pi / 6.0 * true_rho)
    for _ in range(400):
        x = rng.standard_normal(40)
        y = r * x + np.sqrt(1.0 - r * r) * rng.standard_normal(40)
        found = rank_correlation(columns_of(rows_of(zip(x, y, strict=True))), "a", "y")
        held += found is not None and found.low <= true_rho <= found.high
    # three standard deviations of a share of 400 are 0.033
    assert held / 400 == pytest.approx(0.95, abs=0.033)


def test_the_interval_is_bonett_and_wrights():
    """n = 10 and one pair exchanged, rho = 1 - 6 * 2 / 990: tanh(atanh(rho) -+ 1.96 sqrt((1 + rho^2/2) / 7))."""
    order = [1, 2, 3, 4, 6, 5, 7, 8, 9, 10]
    found = rank_correlation(columns_of(rows_of(enumerate(order))), "a", "y")
    assert found is not None
    rho = Fraction(163, 165)
    z = 0.5 * math.log((1 + rho) / (1 - rho))
    half = NormalDist().inv_cdf(0.975) * math.sqrt(float((1 + rho * rho / 2) / 7))
    ends = [(math.exp(2.0 * end) - 1.0) / (math.exp(2.0 * end) + 1.0) for end in (z - half, z + half)]
    # rounding
    assert [found.low, found.high] == pytest.approx(ends, rel=1e-12)
    assert found.rho == pytest.approx(float(rho), rel=1e-15)


def test_runs_without_the_number_are_left_out_and_too_few_say_nothing():
    rows = [*rows_of([(1, 1), (2, 2), (3, 3)]), row(4, {"a": 4.0}), row(5, {"a": "text"}, y=1.0)]
    assert rank_correlation(columns_of(rows), "a", "y") is None


def test_a_star_needs_more_the_more_parameters_are_asked_for():
    def one(p: float) -> Correlation:
        return Correlation(0.5, 0.1, 0.8, p, 30)

    assert starred({"a": one(0.04)}) == {"a"}
    assert starred({"a": one(0.04), "b": one(0.9)}) == set()
    # Holm: the second is held against 0.05 / 2, not 0.05 / 3
    assert starred({"a": one(0.001), "b": one(0.02), "c": one(0.9)}) == {"a", "b"}
