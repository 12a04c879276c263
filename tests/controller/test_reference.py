import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from twin.controller.reference import reference_position

coordinates = st.floats(-0.2, 0.2)


@st.composite
def trajectories(draw):
    n = draw(st.integers(1, 6))
    gaps = [draw(st.floats(0.01, 5.0)) for _ in range(n)]
    points = [[draw(coordinates) for _ in range(3)] for _ in range(n)]
    return np.cumsum(gaps), np.array(points)


@given(trajectories(), st.lists(st.floats(0.0, 40.0), min_size=1, max_size=20))
def test_reference_is_the_straight_line_between_way_points(trajectory, times):
    t, p = trajectory
    segment = 0
    for now in sorted(times):
        x, y, z, segment = reference_position(t, p, segment, now)
        # rounding
        expected = [np.interp(now, t, p[:, i]) for i in range(3)]
        np.testing.assert_allclose((x, y, z), expected, rtol=0, atol=1e-15)


@given(trajectories(), st.floats(0.0, 40.0))
def test_searching_from_the_start_finds_the_same_point(trajectory, now):
    t, p = trajectory
    found = reference_position(t, p, 0, now)
    assert reference_position(t, p, found[3], now) == found


@given(trajectories())
def test_reference_goes_through_its_way_points_and_stays_at_the_last(trajectory):
    t, p = trajectory
    for time, point in zip(t, p, strict=True):
        assert reference_position(t, p, 0, time)[:3] == tuple(point)
    assert reference_position(t, p, 0, t[-1] + 100.0)[:3] == tuple(p[-1])
    assert reference_position(t, p, 0, 0.0)[:3] == tuple(p[0])
