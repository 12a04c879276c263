import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.conftest import examples
from twin.studies.compare.tube import reach

VALUES = st.floats(-10.0, 10.0)
STEPS = st.floats(0.01, 1.0)
# interpolation and shifted stamps round: a few ulps of 10, steepest slope 20/0.01
ROUND = 1e-10


@st.composite
def polygons(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    n = draw(st.integers(2, 30))
    t = np.cumsum(draw(arrays(float, n, elements=STEPS)))
    return t, draw(arrays(float, n, elements=VALUES))


@given(polygons(), st.floats(0.0, 3.0), st.floats(-1.0, 1.0))
def test_a_copy_shifted_by_no_more_than_dt_is_inside_without_any_tolerance(
    polygon: tuple[np.ndarray, np.ndarray], dt: float, part: float
):
    t, values = polygon
    at = t[(t + part * dt >= t[0]) & (t + part * dt <= t[-1])]
    shifted = np.interp(at, t - part * dt, values)
    assert np.all(np.abs(reach(t, values, at, dt).excess(shifted)) <= ROUND)


@given(polygons(), st.floats(0.0, 3.0), st.floats(0.0, 5.0), st.floats(1e-3, 5.0))
def test_whatever_is_above_all_values_by_more_than_the_tolerance_is_outside_by_the_rest(
    polygon: tuple[np.ndarray, np.ndarray], dt: float, tolerance: float, more: float
):
    t, values = polygon
    tube = reach(t, values, t, dt).widened(tolerance)
    high, low = np.full(len(t), values.max() + tolerance + more), np.full(len(t), values.min() - tolerance - more)
    assert np.all(tube.excess(high) >= more - ROUND)
    assert np.all(tube.excess(low) <= -more + ROUND)


@given(polygons(), st.floats(0.0, 3.0))
def test_the_reach_is_the_least_and_the_largest_of_the_polygon_in_the_window(
    polygon: tuple[np.ndarray, np.ndarray], dt: float
):
    t, values = polygon
    at = np.linspace(t[0], t[-1], 7)
    found = reach(t, values, at, dt)
    for k, time in enumerate(at):
        ends = np.clip([time - dt, time + dt], t[0], t[-1])
        inside = np.concatenate([np.interp(ends, t, values), values[(t >= ends[0]) & (t <= ends[1])]])
        assert found.lower[k] == inside.min()
        assert found.upper[k] == inside.max()


@given(polygons(), st.floats(0.0, 3.0))
def test_up_and_down_are_alike(polygon: tuple[np.ndarray, np.ndarray], dt: float):
    t, values = polygon
    up, down = reach(t, values, t, dt), reach(t, -values, t, dt)
    np.testing.assert_array_equal(up.lower, -down.upper)
    np.testing.assert_array_equal(up.upper, -down.lower)


@examples(30)
@given(polygons(), st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_a_wider_window_reaches_no_less(polygon: tuple[np.ndarray, np.ndarray], dt: float, more: float):
    t, values = polygon
    narrow, wide = reach(t, values, t, dt), reach(t, values, t, dt + more)
    assert np.all(wide.lower <= narrow.lower + ROUND)
    assert np.all(wide.upper >= narrow.upper - ROUND)


def test_what_is_not_a_number_is_outside():
    t = np.array([0.0, 1.0])
    assert reach(t, t, t, 0.0).widened(9.0).excess(np.array([0.0, np.nan])).tolist() == [0.0, np.inf]
