import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from twin.report.page.block import DataBlock, thinned, thinning
from twin.studies.packing import values_of

samples = arrays(np.float64, st.integers(1, 200), elements=st.floats(-1e6, 1e6, width=32))


@given(samples, samples)
def test_what_comes_out_of_a_block_is_what_went_in_to_32_bits(a: np.ndarray, b: np.ndarray):
    block = DataBlock()
    places = [block.add(a), block.add(b)]
    whole = values_of(block.text())
    for values, (at, count) in zip((a, b), places, strict=True):
        np.testing.assert_array_equal(whole[at : at + count], values.astype(np.float32))


@given(samples, st.integers(2, 20))
def test_thinning_keeps_every_peak_where_it_was(values: np.ndarray, factor: int):
    few = thinned(values, factor)
    assert len(few) == 2 * -(-len(values) // (2 * factor))
    for bucket, pair in enumerate(few.reshape(-1, 2)):
        own = values[2 * factor * bucket : 2 * factor * (bucket + 1)]
        assert pair.min() == own.min() and pair.max() == own.max()


def test_few_samples_are_not_thinned():
    values = np.arange(10.0)
    assert thinned(values, thinning(10, 10)) is values
    assert thinning(11, 10) == 2
