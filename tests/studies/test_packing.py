"""Samples as text."""

import base64
import zlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from twin.studies.packing import MAX_BYTES, text_of, values_of


@given(arrays(np.float32, st.integers(0, 200)))
def test_what_comes_back_is_what_went_in_to_the_last_of_32_bits(values: np.ndarray):
    np.testing.assert_array_equal(values_of(text_of(values)).astype(np.float32), values)


def test_text_of_another_version_is_read():
    # rows of sweeps and pages that were written before
    assert text_of(np.array([1.0, -0.5, 5.0])) == "eJxjYACBhoYF9vWNAApIAuA="
    np.testing.assert_array_equal(values_of("eJxjYACBhoYF9vWNAApIAuA="), [1.0, -0.5, 5.0])


@pytest.mark.parametrize("content", [b"no zlib", zlib.compress(b"12345")])
def test_what_is_no_such_text_is_refused(content: bytes):
    with pytest.raises(ValueError):
        values_of(base64.b64encode(content).decode())


def test_no_more_is_unpacked_than_a_sweep_may_keep():
    bomb = base64.b64encode(zlib.compress(bytes(2 * MAX_BYTES))).decode()
    assert len(values_of(bomb)) == MAX_BYTES / 4
