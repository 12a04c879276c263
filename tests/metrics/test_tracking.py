import numpy as np
import pytest

from twin.metrics.tracking import bump, mean_error, rms

t = np.linspace(12.5, 15.2, 1351)


def test_rms_of_a_sine_is_its_amplitude_over_root_two():
    x = 3.0 * np.sin(np.linspace(0.0, 2 * np.pi, 1000, endpoint=False))
    assert rms(x) == pytest.approx(3.0 / np.sqrt(2.0), rel=1e-12)


def test_mean_error_counts_both_sides():
    assert mean_error(np.array([1.0, -1.0]), 0.0) == 1.0


def test_a_bump_on_a_cubic_is_found_where_it_is():
    trend = 4.9 + 0.02 * (t - 14) + 0.01 * (t - 14) ** 3
    time, size = bump(t, trend + 0.05 * np.exp(-(((t - 13.7) / 0.01) ** 2)))
    assert time == pytest.approx(13.7, abs=0.002)
    # the fit takes up a little of so short a bump
    assert size == pytest.approx(0.05, rel=0.05)
