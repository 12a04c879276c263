"""How metrics are spread: nothing is lost on the way."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from tests.studies.sweep.statistics.rows import row
from twin.studies.sweep.columns import columns_of
from twin.studies.sweep.statistics.distribution import BINS, spread


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=30), st.integers(0, 3))
@example([0.0, 1.5e-247], 0)
@example([1000.0, math.nextafter(1000.0, math.inf)], 0)
@example([0.0, 5e-12], 0)
def test_every_run_is_in_a_bin_or_counted_as_missing(numbers: list[float], failed: int):
    rows = [row(n, {}, y=number) for n, number in enumerate(numbers)] + [row(100 + n, {}) for n in range(failed)]
    found = spread(columns_of(rows), "y")
    assert found is not None
    assert sum(found.counts) == len(numbers) and found.missing == failed
    # a metric has 12 decimals, and a double near 1,000 as many
    if (range_ := float(np.ptp(numbers))) > 3e-12 * max(1.0, *np.abs(numbers)):
        assert len(found.counts) == BINS
        # each number and each edge is off by a rounding
        assert found.edges[-1] - found.edges[0] == pytest.approx(range_, abs=2e-12)
    elif range_ < 1e-13:
        assert len(found.counts) == 1
    assert found.edges[0] <= found.numbers.min() and found.numbers.max() <= found.edges[-1]
    np.testing.assert_allclose(np.diff(found.edges), np.diff(found.edges)[0], rtol=1e-9, atol=1e-12)
    assert list(found.quantiles) == sorted(found.quantiles)


def test_a_metric_that_no_run_has_is_not_spread():
    assert spread(columns_of([row(1, {})]), "y") is None
