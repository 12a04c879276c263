"""The strongest sine, on signals whose sines are known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.studies.metrics.oscillation import PERIODS, strongest_swing

T = np.arange(0.0, 5.0, 0.001)


@given(f=st.floats(1.0, 200.0), a=st.floats(1e-4, 10.0), phase=st.floats(0.0, 6.28), slope=st.floats(-1.0, 1.0))
def test_a_sine_on_a_slope_has_its_amplitude_and_frequency(f: float, a: float, phase: float, slope: float):
    y = a * np.sin(2.0 * np.pi * f * T + phase) + a * (3.0 + slope * T)
    amplitude, frequency = strongest_swing(T, y, PERIODS / 5.0)
    # between two frequencies of the transform 0.3 %, and 1.5 % of the slow ones, a part of which is taken for the slope
    assert amplitude == pytest.approx(a, rel=0.02 if f < 2.0 else 0.004)
    # half a step of the padded transform, and what the slope takes of five periods
    assert frequency == pytest.approx(f, abs=0.04)


def test_of_two_sines_the_stronger_one_is_told_and_of_slow_ones_none():
    y = (
        0.5 * np.sin(2.0 * np.pi * 13.0 * T)
        + 0.1 * np.sin(2.0 * np.pi * 40.0 * T)
        + 2.0 * np.sin(2.0 * np.pi * 0.3 * T)
    )
    assert strongest_swing(T, y, 4.0) == (pytest.approx(0.5, rel=0.01), pytest.approx(13.0, abs=0.05))
    assert strongest_swing(T, y, 25.0) == (pytest.approx(0.1, rel=0.01), pytest.approx(40.0, abs=0.05))


def test_what_rests_does_not_swing():
    assert strongest_swing(T, np.full_like(T, 5.0), 1.0)[0] < 1e-12
