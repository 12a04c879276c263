"""What can be said of an order, and what cannot."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.studies.converge.convergence import OrderFinding, observed_order

TICKS = 1e-3 * np.array([2.0, 1.0, 0.5, 0.25])


@given(st.floats(0.6, 4.0), st.floats(1e-6, 1e3))
def test_a_power_of_the_tick_is_its_own_order(p: float, C: float):
    order = observed_order(TICKS, C * TICKS**p, 0.0)
    # rounding of logarithms
    assert order.slope == pytest.approx(p, abs=1e-9)
    assert order.finding is OrderFinding.SMOOTH


@given(st.permutations(range(4)))
def test_the_sequence_of_the_runs_does_not_matter(sequence: list[int]):
    errors = TICKS**2 * np.array([1.0, 1.1, 0.9, 1.0])
    one, other = observed_order(TICKS, errors, 0.0), observed_order(TICKS[sequence], errors[sequence], 0.0)
    # rounding of sums in another sequence
    assert other.slope == pytest.approx(one.slope, abs=1e-9)
    assert other.finding is one.finding


def test_slopes_that_contradict_each_other_are_said_to():
    errors = [8e-3, 4e-3, 1e-3, 5e-4]
    assert observed_order(TICKS, errors, 0.0).finding is OrderFinding.NOT_SMOOTH


def test_an_error_that_does_not_fall_has_no_order():
    order = observed_order(TICKS, [1e-3, 1.1e-3, 0.9e-3, 1e-3], 0.0)
    assert order.slope is None and order.finding is OrderFinding.NOT_FALLING


def test_errors_near_the_floor_are_left_out_and_too_few_others_make_no_order():
    errors = np.array([1.6e-3, 4e-4, 1e-4, 7e-5])
    # the last one is not an eighth of a square of anything: it has met the floor
    order = observed_order(TICKS, errors, 8e-6)
    assert order.slope == pytest.approx(2.0, abs=1e-9) and order.finding is OrderFinding.SMOOTH
    order = observed_order(TICKS, errors, 2e-5)
    assert order.slope is None and order.finding is OrderFinding.AT_FLOOR


def test_a_run_that_failed_leaves_no_order():
    order = observed_order(TICKS, [np.inf, 1e-3, 5e-4, 2.5e-4], 0.0)
    assert order.slope is None and order.finding is OrderFinding.UNSTABLE
