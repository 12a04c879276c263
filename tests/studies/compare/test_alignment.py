import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.conftest import examples
from twin.studies.compare.alignment import alignment, shift
from twin.studies.compare.tolerance import ComparisonRefused

from .logs import log_of

T = np.arange(0.0, 10.0, 0.01)


def bump(t: np.ndarray) -> np.ndarray:
    return np.exp(-((t - 4.0) ** 2))


@examples(20)
@given(st.floats(-0.9, 0.9))
def test_a_fit_finds_the_shift_between_two_samplings_of_one_curve(delay: float):
    found = shift(log_of(T, F=bump(T)), log_of(T + 0.003, F=bump(T + 0.003 - delay)), alignment("fit", "F"))
    # chords of 10 ms are off by f'' h^2/8 = 2.5e-5, the curve rises by up to 0.86 per s
    assert found.seconds == pytest.approx(-delay, abs=1e-4)
    assert found.note == ""


def test_a_fit_at_its_bound_says_so():
    found = shift(log_of(T, F=bump(T)), log_of(T, F=bump(T - 1.0)), alignment("fit", "F", 0.5))
    assert found.seconds == pytest.approx(-0.5, abs=1e-3)  # the grid's last point
    assert "widen it" in found.note


def test_starts_are_aligned_by_the_first_samples():
    assert shift(log_of(T, F=T), log_of(T + 1.7e3, F=T), alignment("start")).seconds == -1.7e3


def test_events_are_aligned_where_the_signal_crosses_the_middle_of_the_range():
    step = np.where(T > 3.0, 1.0, 0.0)
    found = shift(log_of(T, on=step), log_of(T, on=np.where(T > 5.0, 1.0, 0.0)), alignment("event", "on"))
    assert found.seconds == pytest.approx(-2.0, abs=1e-9)  # round-off of the times


@pytest.mark.parametrize(
    ("kind", "signal", "max_shift", "expected"),
    [
        ("middle", "", 1.0, "--align middle: expected one of none, start, event, fit"),
        ("fit", "", 1.0, "--align fit: by which signal"),
        ("fit", "F", 0.0, "--max-shift 0: expected a time > 0 s"),
    ],
)
def test_an_alignment_that_says_too_little_is_refused(kind: str, signal: str, max_shift: float, expected: str):
    with pytest.raises(ComparisonRefused, match=expected):
        alignment(kind, signal, max_shift)


def test_a_signal_that_shows_nothing_is_refused():
    flat, low = log_of(T, F=np.ones_like(T)), log_of(T, F=0.1 * bump(T))
    with pytest.raises(ComparisonRefused, match="is constant"):
        shift(log_of(T, F=bump(T)), flat, alignment("fit", "F"))
    with pytest.raises(ComparisonRefused, match=r"F never crosses 0\.5"):
        shift(log_of(T, F=bump(T)), low, alignment("event", "F"))
    with pytest.raises(ComparisonRefused, match="overlap by less than half"):
        shift(log_of(T, F=bump(T)), log_of(T + 50.0, F=bump(T)), alignment("fit", "F"))
