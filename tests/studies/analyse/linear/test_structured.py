import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import minimize

from tests.conftest import examples
from twin.studies.analyse.linear.structured import largest

MATRICES = st.tuples(st.integers(2, 7), st.integers(0, 10_000))


def drawn(rows: int, seed: int, *shape: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(*shape, rows, rows)) + 1j * rng.normal(size=(*shape, rows, rows))


def bound(M: np.ndarray) -> float:
    return largest(M[None])[1]


def reached(M: np.ndarray) -> float:
    """The largest spectral radius of Delta M over diagonal Delta of size 1 that were tried: mu is at least that."""

    def radius(angles: np.ndarray) -> float:
        return -float(np.abs(np.linalg.eigvals(np.exp(1j * np.concatenate([[0.0], angles]))[:, None] * M)).max())

    starts = np.random.default_rng(0).uniform(0.0, 2.0 * np.pi, (12, len(M) - 1))
    return -min(minimize(radius, start, method="BFGS").fun for start in starts)


@examples(10)
@given(st.tuples(st.integers(2, 3), st.integers(0, 10_000)))
def test_up_to_three_rows_the_bound_is_reached(case):
    M = drawn(*case)
    # 2048th powers for the largest singular value
    assert reached(M) == pytest.approx(bound(M), rel=2e-3)


@examples(5)
@given(st.integers(0, 10_000))
def test_beyond_it_is_no_less_than_what_is_reached(seed):
    M = drawn(6, seed)
    assert reached(M) <= bound(M) * (1.0 + 1e-9)


@examples(20)
@given(MATRICES)
def test_of_a_matrix_of_rank_one_it_is_the_sum_of_the_diagonal_s_sizes(case):
    u, v = drawn(*case)[:2]
    # det(1 - Delta u v^H) = 1 - sum of delta_i u_i conj(v_i)
    assert bound(np.outer(u, v.conj())) == pytest.approx(np.abs(u * v).sum(), rel=1e-6)


@examples(20)
@given(MATRICES)
def test_of_a_diagonal_or_triangular_matrix_it_is_the_largest_diagonal_element(case):
    M = drawn(*case)
    expected = np.abs(np.diag(M)).max()
    assert bound(np.diag(np.diag(M))) == pytest.approx(expected, rel=1e-9)
    # the best scaling is infinite: what is left of the corner
    assert bound(np.triu(M)) == pytest.approx(expected, rel=2e-3)


@examples(20)
@given(MATRICES)
def test_units_of_the_signals_do_not_matter(case):
    M = drawn(*case)
    D = np.exp(np.random.default_rng(case[1]).uniform(-3.0, 3.0, len(M)))
    assert bound(D[:, None] * M / D) == pytest.approx(bound(M), rel=1e-3)


def test_the_largest_of_many_is_found_without_looking_at_each():
    many = drawn(5, 3, 40)
    which, found = largest(many)
    each = [bound(M) for M in many]
    assert which == int(np.argmax(each)) and found == pytest.approx(max(each), rel=1e-3)
