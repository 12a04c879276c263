import numpy as np
import pytest

from twin.studies.replay.residual import residual, statistics

T = np.arange(0.0, 20.0, 0.002)
NO_GAPS = np.empty((0, 2))


def bump(t: np.ndarray) -> np.ndarray:
    return 5.0 / (1.0 + np.exp(-10.0 * (t - 8.0)))


def test_each_measurement_has_the_newest_value_beside_it():
    found = residual(np.array([0.0, 1.0, 2.0]), np.array([1.0, 2.0, 3.0]), NO_GAPS, np.array([0.5, 2.0]), np.zeros(2))
    np.testing.assert_array_equal(found.value, [1.0, 3.0])


def test_measurements_before_the_first_value_after_the_last_and_in_gaps_are_left_out():
    gaps = np.array([[2.0, 5.0]])
    t = np.array([0.0, 1.0, 2.0, 5.0, 6.0])
    found = residual(t, t, gaps, np.array([-0.1, 1.0, 2.5, 4.0, 6.0, 8.0]), np.zeros(6))
    np.testing.assert_array_equal(found.t, [1.0, 6.0])


def test_statistics_are_those_of_the_differences():
    r = np.where(T < 10.0, 0.1, 0.3)
    s = statistics(residual(T, bump(T) + r, NO_GAPS, T, bump(T)))
    # round-off of 10000 sums of size 5
    assert (s.bias, s.std, s.rms) == pytest.approx((0.2, 0.1, np.sqrt(0.05)), abs=1e-12)
    assert s.largest == pytest.approx(0.3)
    assert s.at >= 10.0


@pytest.mark.parametrize("late", [-0.04, 0.0, 0.05])
def test_lag_is_how_much_later_the_value_comes(late: float):
    measured_at = np.arange(0.0, 20.0, 0.01)
    noise = np.random.default_rng(0).normal(0.0, 0.02, len(T))
    s = statistics(residual(T, bump(T - late) + noise, NO_GAPS, measured_at, bump(measured_at)))
    # a sample of the measurement
    assert s.lag == pytest.approx(late, abs=0.0101)


def test_a_force_that_stands_still_has_neither_correlation_nor_lag():
    s = statistics(residual(T, bump(T), NO_GAPS, T, np.zeros(len(T))))
    assert np.isnan(s.correlation) and np.isnan(s.lag)
