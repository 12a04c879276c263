import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import lfilter

from twin.studies.replay.drift import Drift, _sum, correlation_time, drift

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
