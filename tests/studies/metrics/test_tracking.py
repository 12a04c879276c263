import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.studies.metrics.tracking import lag, level_changes, mean_error, path_error, rms

t = np.linspace(12.5, 15.2, 1351)


def test_rms_of_a_sine_is_its_amplitude_over_root_two():
    x = 3.0 * np.sin(np.linspace(0.0, 2 * np.pi, 1000, endpoint=False))
    assert rms(x) == pytest.approx(3.0 / np.sqrt(2.0), rel=1e-12)


def test_mean_error_counts_both_sides():
    assert mean_error(np.array([1.0, -1.0]), 0.0) == 1.0


def test_a_step_is_where_the_level_changes_most_and_as_large():
    times, changes = level_changes(t, 4.9 + np.where(t > 13.7, 0.05, 0.0), 0.2)
    largest = int(np.argmax(np.abs(changes)))
    # the first sample after it
    assert times[largest] == pytest.approx(13.702, abs=1e-9)
    # rounding of sums of thousands
    assert changes[largest] == pytest.approx(0.05, abs=1e-9)
    assert np.abs(changes[np.abs(times - 13.7) > 0.21]).max() < 1e-9


def test_a_line_changes_its_level_by_its_slope_everywhere():
    times, changes = level_changes(t, 3.0 * t, 0.2)
    assert changes == pytest.approx(np.full(len(times), 0.6), abs=1e-9)
    assert (times[0], times[-1]) == pytest.approx((t[0] + 0.2, t[-1] - 0.2), abs=0.003)


def test_the_lag_of_a_delayed_signal_is_its_delay():
    delayed = np.sin(3.0 * (t - 0.08))
    # over no whole number of waves, the square error is not quite a parabola
    assert lag(t, delayed, np.sin(3.0 * t), 0.5) == pytest.approx(0.08, abs=1e-6)


@given(st.floats(0.0, 0.3))
def test_a_lag_lies_between_samples(delay: float):
    # as above; a tenth of a percent of a sample of 2 ms
    assert lag(t, np.sin(9.0 * (t - delay)), np.sin(9.0 * t), 0.4) == pytest.approx(delay, abs=2e-6)


def test_what_comes_early_has_no_lag():
    assert lag(t, np.sin(3.0 * (t + 0.08)), np.sin(3.0 * t), 0.5) == 0.0


def test_what_follows_its_path_late_is_late_but_on_it():
    path = np.column_stack([np.cos(t), np.sin(t), 0.0 * t])
    late = np.column_stack([np.cos(t - 0.1), np.sin(t - 0.1), 0.0 * t])[t > 12.7]
    # the circle bulges beyond its chords of 2 mrad by 5e-7
    assert np.max(path_error(late, path)) < 1e-6


@given(st.floats(-2.0, 2.0), st.floats(-1.0, 3.0))
def test_path_error_is_the_distance_to_a_segment_and_beyond_its_ends_to_the_end(off, along):
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 0.0], [2.0, 0.0]])
    beyond = max(0.0, -along, along - 2.0)
    assert path_error(np.array([[along, off]]), corners)[0] == pytest.approx(np.hypot(off, beyond), abs=1e-12)


def test_round_a_corner_the_path_is_followed_segment_by_segment():
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [1.0, 2.0]])
    # beside the end of the first segment, where the way from one corner to the one after next would be nearer
    assert path_error(np.array([[0.6, 0.2]]), corners)[0] == pytest.approx(0.2, abs=1e-12)
    assert path_error(np.array([[1.1, 0.6]]), corners)[0] == pytest.approx(0.1, abs=1e-12)
    assert path_error(np.array([[0.4, 0.3]]), corners)[0] == pytest.approx(0.3, abs=1e-12)
