"""How metrics are spread: nothing is lost on the way."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.sweep.statistics.rows import row
from twin.sweep.statistics.distribution import BINS, spread


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=30), st.integers(0, 3))
def test_every_run_is_in_a_bin_or_counted_as_missing(numbers: list[float], failed: int):
    rows = [row(n, {}, y=number) for n, number in enumerate(numbers)] + [row(100 + n, {}) for n in range(failed)]
    found = spread(rows, "y")
    assert found is not None
    assert sum(found.counts) == len(numbers) and found.missing == failed
    assert len(found.counts) == (BINS if np.ptp(numbers) > 0.0 else 1)
    assert list(found.quantiles) == sorted(found.quantiles)


def test_a_metric_that_no_run_has_is_not_spread():
    assert spread([row(1, {})], "y") is None
