import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from twin.studies.replay.drift import Drift, _sum, correlation_time, drift
from twin.studies.replay.residual import residual, statistics

PERIOD = 0.01
T = np.arange(0.0, 60.0, PERIOD)


def noisy(seed: int, correlation: float = 0.0) -> np.ndarray:
    """Noise of deviation 0.1 whose autocorrelation falls by 1/e in `correlation` (s)."""
    rng = np.random.default_rng(seed)
    a = np.exp(-PERIOD / correlation) if correlation else 0.0
    r = rng.normal(0.0, 0.1 * np.sqrt(1.0 - a * a), len(T))
    r[0] /= np.sqrt(1.0 - a * a)
    return lfilter([1.0], [1.0, -a], r)


def judged(r: np.ndarray, tolerance: float = 0.05, baseline: float = 5.0) -> Drift:
    found = drift(T, r, baseline, tolerance, 0.01)
    assert found is not None
    return found


@given(st.integers(0, 10_000))
def test_noise_without_drift_raises_no_alarm(seed: int):
    # 55 blocks; at the very edge of the tolerance one alarm in 465 blocks is by chance, in its middle none
    assert judged(noisy(seed)).matches


def test_samples_that_say_the_same_twice_are_no_evidence():
    alarms = [not judged(noisy(seed, 0.5), tolerance=0.05, baseline=20.0).matches for seed in range(100)]
    # means of 1 s deviate by 0.1 then: taken for those of 100 independent samples, nearly every log would be one
    assert np.mean(alarms) < 0.05


@given(st.integers(0, 10_000), st.sampled_from([-1.0, 1.0]))
def test_a_step_beyond_the_tolerance_is_seen_with_its_time_size_and_sign(seed: int, sign: float):
    found = judged(noisy(seed) + sign * 0.3 * (T >= 30.0))
    assert 30.0 < found.alarm <= 32.0
    assert found.since == pytest.approx(30.0, abs=found.block + PERIOD)
    # two blocks of 100 samples of 0.1, and the baseline of 500
    assert found.size == pytest.approx(sign * 0.3, abs=0.05)


def test_a_step_within_the_tolerance_is_never_seen():
    assert judged(0.04 * (T >= 30.0)).matches


def test_a_slow_drift_is_seen_once_it_has_left_the_tolerance():
    # 0.01 per second from 20 s on leaves 0.05 at 25 s
    found = judged(noisy(0) + 0.01 * np.maximum(0.0, T - 20.0))
    assert 25.0 < found.alarm < 31.0


@given(st.lists(st.floats(-10, 10), min_size=1, max_size=50))
def test_the_sum_is_pages_recursion(steps: list[float]):
    total, sums = 0.0, []
    for step in steps:
        total = max(0.0, total + step)
        sums.append(total)
    # the sum of 50 numbers of size 10 in another order
    np.testing.assert_allclose(_sum(np.array(steps)), sums, rtol=0, atol=1e-11)


def test_correlation_time_is_where_the_autocorrelation_falls_below_one_e():
    # 60 s hold 300 correlation times: known to a tenth or so
    assert correlation_time(T, noisy(1, 0.2)) == pytest.approx(0.2, rel=0.3)
    assert correlation_time(T, noisy(1)) == pytest.approx(PERIOD)
    assert correlation_time(T, np.ones(len(T))) == 0.0


def test_chance_alarms_at_the_edge_of_the_tolerance_come_about_once_in_930_blocks():
    rng = np.random.default_rng(0)
    lengths = []
    for _ in range(200):
        above = np.flatnonzero(_sum(rng.normal(-0.5, 1.0, 20_000)) > 5.0)
        lengths.append(above[0] + 1)
    # exponential run lengths: 200 of them give the mean to 7 percent
    assert np.mean(lengths) == pytest.approx(930, rel=0.2)


def test_a_log_without_a_block_after_its_baseline_gives_nothing():
    assert drift(T[:600], np.zeros(600), 5.5, 0.1, 0.1) is None


RESIDUAL_T = np.arange(0.0, 20.0, 0.002)
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
    r = np.where(RESIDUAL_T < 10.0, 0.1, 0.3)
    s = statistics(residual(RESIDUAL_T, bump(RESIDUAL_T) + r, NO_GAPS, RESIDUAL_T, bump(RESIDUAL_T)))
    # round-off of 10000 sums of size 5
    assert (s.bias, s.std, s.rms) == pytest.approx((0.2, 0.1, np.sqrt(0.05)), abs=1e-12)
    assert s.largest == pytest.approx(0.3)
    assert s.at >= 10.0


@pytest.mark.parametrize("late", [-0.04, 0.0, 0.05])
def test_lag_is_how_much_later_the_value_comes(late: float):
    measured_at = np.arange(0.0, 20.0, 0.01)
    noise = np.random.default_rng(0).normal(0.0, 0.02, len(RESIDUAL_T))
    s = statistics(residual(RESIDUAL_T, bump(RESIDUAL_T - late) + noise, NO_GAPS, measured_at, bump(measured_at)))
    # a sample of the measurement
    assert s.lag == pytest.approx(late, abs=0.0101)


def test_a_force_that_stands_still_has_neither_correlation_nor_lag():
    s = statistics(residual(RESIDUAL_T, bump(RESIDUAL_T), NO_GAPS, RESIDUAL_T, np.zeros(len(RESIDUAL_T))))
    assert np.isnan(s.correlation) and np.isnan(s.lag)
