import numpy as np
import pytest

from twin.studies.metrics.effort import travel, work

t = np.linspace(0.0, 2.0 * np.pi, 10_001)
# trapezoids of a smooth curve, and the kinks of |sin| between samples: second order in 0.6 ms
TRAPEZOID = 1e-5


def test_a_shaft_that_swings_once_travels_four_amplitudes():
    assert travel(t, 3.0 * np.cos(t)) == pytest.approx(12.0, abs=TRAPEZOID)


def test_travel_adds_up_over_shafts():
    assert travel(t, np.column_stack([np.cos(t), np.sin(t)])) == pytest.approx(8.0, abs=TRAPEZOID)


def test_a_spring_returns_what_was_delivered():
    # torque k phi at phi = sin t: half the time it drives
    delivered, returned = work(t, np.sin(t)[:, None], np.cos(t)[:, None])
    assert delivered == pytest.approx(1.0, abs=TRAPEZOID)
    assert returned == pytest.approx(1.0, abs=TRAPEZOID)


def test_a_damper_returns_nothing():
    delivered, returned = work(t, 0.5 * np.cos(t)[:, None], np.cos(t)[:, None])
    assert delivered == pytest.approx(0.5 * np.pi, abs=TRAPEZOID)
    assert returned == 0.0
