import numpy as np

from twin.studies.identify.clustered import line, sandwich, t_factor


def test_two_clusters_have_one_degree_of_freedom():
    # Student's t of one degree of freedom is Cauchy's: tan(pi 0.475)
    np.testing.assert_allclose(t_factor(2), np.tan(np.pi * 0.475), rtol=1e-9)
    assert t_factor(1) == np.inf


def test_repeating_every_row_makes_no_interval_narrower():
    rng = np.random.default_rng(1)
    A, y, cluster = rng.normal(size=(40, 2)), rng.normal(size=40), np.arange(40) // 4
    once, often = line(A, y, cluster), line(np.tile(A, (9, 1)), np.tile(y, 9), np.tile(cluster, 9))
    assert once is not None and often is not None
    np.testing.assert_allclose(often.coefficients, once.coefficients, rtol=1e-9)
    np.testing.assert_allclose(often.half_widths, once.half_widths, rtol=1e-9)


def test_the_scatter_between_clusters_is_that_of_leaving_each_out():
    rng = np.random.default_rng(2)
    A, y, cluster = rng.normal(size=(30, 3)), rng.normal(size=30), np.arange(30) // 5
    c = np.linalg.lstsq(A, y, rcond=None)[0]
    without = [np.linalg.lstsq(A[cluster != g], y[cluster != g], rcond=None)[0] - c for g in range(6)]
    expected = 5.0 / 6.0 * np.transpose(without) @ without
    np.testing.assert_allclose(sandwich(A, np.linalg.pinv(A), y - A @ c, cluster), expected, rtol=1e-9, atol=1e-12)


def test_what_the_rows_do_not_say_has_no_line():
    assert line(np.ones((9, 2)), np.arange(9.0), np.arange(9)) is None
