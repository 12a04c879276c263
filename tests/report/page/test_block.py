import base64
import zlib

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from twin.report.page.block import Block, thinned, thinning

samples = arrays(np.float64, st.integers(1, 200), elements=st.floats(-1e6, 1e6, width=32))


def decoded(text: str) -> np.ndarray:
    """What the page's script makes of a block, in numpy."""
    planes = np.frombuffer(zlib.decompress(base64.b64decode(text)), np.uint8).reshape(4, -1)
    steps = np.ascontiguousarray(planes.T).view("<u4").ravel()
    return np.cumsum(steps, dtype=np.uint32).view("<f4")


@given(samples, samples)
def test_what_comes_out_of_a_block_is_what_went_in_to_32_bits(a: np.ndarray, b: np.ndarray):
    block = Block()
    places = [block.add(a), block.add(b)]
    whole = decoded(block.text())
    for values, (at, count) in zip((a, b), places, strict=True):
        np.testing.assert_array_equal(whole[at : at + count], values.astype(np.float32))


def test_what_is_not_a_number_stays_so():
    block = Block()
    block.add(np.array([1.0, np.nan, -np.inf, -0.0]))
    np.testing.assert_array_equal(decoded(block.text()), np.array([1.0, np.nan, -np.inf, -0.0], np.float32))


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
