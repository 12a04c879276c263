import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.studies.metrics.path import along_and_off, fitted_circle, turns_about

angle = np.linspace(0.0, 2.0 * np.pi, 200, endpoint=False)
mm = st.floats(-0.02, 0.02)


@given(mm, mm, st.floats(0.001, 0.02))
def test_a_circle_is_found_wherever_it_is(x, y, r):
    # rounding of squares of at most 0.04 m, relative to the smallest radius
    assert fitted_circle(x + r * np.cos(angle), y + r * np.sin(angle)) == pytest.approx((x, y, r), abs=1e-12)


def test_noise_on_every_side_leaves_the_radius():
    wavy = 5.0 + 0.1 * np.cos(7 * angle)
    # the square of the wave, 0.1^2/(4*5), is what the algebraic fit counts too much
    assert fitted_circle(wavy * np.cos(angle), wavy * np.sin(angle))[2] == pytest.approx(5.0, abs=0.001)


def test_turns_are_counted_with_their_sense():
    way = np.linspace(0.0, 6.0 * np.pi, 1000)
    x, y = 1.0 + np.cos(way), 2.0 + np.sin(way)
    # sums of rounded angles
    assert turns_about(x, y, (1.0, 2.0)) == pytest.approx(3.0, abs=1e-12)
    assert turns_about(x[::-1], y[::-1], (1.0, 2.0)) == pytest.approx(-3.0, abs=1e-12)


@given(mm, mm)
def test_along_and_off_are_coordinates_turned_into_the_line(x, y):
    along, off = along_and_off(np.array([[x, y]]), (0.0, 0.02), (0.0, -0.02))
    # rounding of numbers below 0.04
    assert (along[0], off[0]) == pytest.approx((0.02 - y, x), abs=1e-15)
