import numpy as np
import pytest

from twin.studies.metrics.repetition import variation


def test_variation_of_two_values_is_half_their_difference_over_their_mean():
    # one rounding
    assert variation(np.array([2.7, 3.3])) == pytest.approx(0.1, rel=1e-12)


def test_what_is_always_the_same_does_not_vary():
    assert variation(np.full(10, 3.0)) == 0.0
