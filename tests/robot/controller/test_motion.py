"""References of one phase: smooth lines, and circles that are spiralled into and out of."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin.robot.controller.machine import (
    circle_offset,
    circle_time,
    line_share,
    line_speed,
    line_time,
    motion,
    motion_time,
)
from twin.robot.controller.program import PHASE_RECORD, Phase, PhaseKind

lengths = st.floats(1e-4, 0.1)
speeds = st.floats(1e-3, 0.2)
ramps = st.floats(0.01, 0.5)
rates = st.floats(0.1, 3.0)
radii = st.floats(1e-3, 0.01)
turns = st.floats(1.0, 5.0)


def record(**values):
    return np.array([tuple(Phase(PhaseKind.TRAVEL, 1, **values))], dtype=PHASE_RECORD)[0]


def line(length, speed, ramp_in, ramp_out, samples=2001):
    """Phase, times, paths (m) and speeds (m/s) along a line, to its end."""
    phase = record(speed=speed, ramp_in=ramp_in, ramp_out=ramp_out)
    t = np.linspace(0.0, line_time(phase, length), samples)
    path, v = np.array([line_share(phase, length, x) for x in t]).T
    return phase, t, path, v


def circle(radius, rate, turns, samples=2001):
    """Phase, times, offsets (n, 2) and velocities (n, 2) of a circle."""
    phase = record(radius=radius, rate=rate, turns=turns)
    t = np.linspace(0.0, circle_time(phase), samples)
    found = np.array([circle_offset(phase, x) for x in t])
    return phase, t, found[:, :2], found[:, 2:]


def assert_integral(t, p, v, curvature, kink=0.0):
    """`p` is the integral of `v`, whose slope jumps by `kink` at most and bends by `curvature` at most."""
    dt = t[1] - t[0]
    # what the trapezoidal rule is off by, the bend twice because it may jump too; and rounding
    atol = curvature * dt**3 / 6 + kink * dt**2 / 8 + 1e-15
    np.testing.assert_allclose(np.diff(p, axis=0), dt * (v[1:] + v[:-1]) / 2, rtol=0, atol=atol)


@given(lengths, speeds, ramps, ramps)
def test_the_path_along_a_line_is_the_integral_of_its_speed(length, speed, ramp_in, ramp_out):
    _, t, path, v = line(length, speed, ramp_in, ramp_out)
    assert_integral(t, path, v, 6.0 * v.max() / min(ramp_in, ramp_out) ** 2)


@given(lengths, speeds, ramps, ramps)
def test_a_line_never_goes_back_nor_faster_than_its_speed(length, speed, ramp_in, ramp_out):
    _, _, path, v = line(length, speed, ramp_in, ramp_out)
    # rounding
    assert np.diff(path).min() >= -1e-16
    assert v.max() <= speed * (1.0 + 1e-12)


@given(lengths, speeds, ramps, ramps)
def test_a_line_starts_and_ends_at_rest_exactly_at_its_end(length, speed, ramp_in, ramp_out):
    phase, t, path, v = line(length, speed, ramp_in, ramp_out)
    assert (path[0], v[0]) == (0.0, 0.0)
    assert (path[-1], v[-1]) == (length, 0.0)
    assert line_share(phase, length, t[-1] + 1.0) == (length, 0.0)
    # a hundredth of a ramp before, it is still on its way
    assert line_share(phase, length, t[-1] - 0.01 * ramp_out)[0] < length


@given(lengths, speeds, ramps, ramps)
def test_speed_along_a_line_does_not_jump(length, speed, ramp_in, ramp_out):
    phase, t, _, v = line(length, speed, ramp_in, ramp_out)
    # the steepest slope of the ramp is 3/2 of its mean
    assert np.abs(np.diff(v)).max() <= 1.5 * line_speed(phase, length) / min(ramp_in, ramp_out) * (t[1] - t[0]) * (
        1.0 + 1e-9
    )


def test_a_long_line_takes_its_length_over_its_speed_and_the_mean_of_both_ramps():
    phase = record(speed=0.04, ramp_in=0.1, ramp_out=0.3)
    # rounding
    assert line_time(phase, 0.04) == pytest.approx(1.0 + 0.2, rel=1e-14)
    assert line_speed(phase, 0.04) == 0.04


def test_a_line_too_short_for_both_ramps_is_slower_and_takes_the_ramps_time():
    phase, t, _, v = line(0.001, 0.04, 0.1, 0.3)
    assert t[-1] == pytest.approx(0.4, rel=1e-14)
    # the area under two ramps is half their duration times the speed; seen on a grid of t/2000
    assert v.max() == pytest.approx(2.0 * 0.001 / 0.4, rel=1e-5)
    assert line_speed(phase, 0.001) == pytest.approx(0.005, rel=1e-14)


def test_a_line_without_ramps_has_its_speed_at_once_and_to_the_end():
    _, _, path, v = line(0.01, 0.1, 0.0, 0.0)
    np.testing.assert_array_equal(v[:-1], 0.1)
    # rounding
    np.testing.assert_allclose(path, np.linspace(0.0, 0.01, len(path)), rtol=0, atol=1e-17)


@pytest.mark.parametrize("ramp_in", [0.0, 0.1])
def test_a_rounding_before_its_start_a_line_is_at_its_start(ramp_in):
    phase = record(speed=0.1, ramp_in=ramp_in, ramp_out=0.1)
    assert line_share(phase, 0.05, -1e-18) == line_share(phase, 0.05, 0.0) == (0.0, 0.0 if ramp_in else 0.1)


def test_a_line_of_no_length_takes_no_time_and_stays():
    phase = record(speed=0.1, ramp_in=0.1, ramp_out=0.1)
    assert line_time(phase, 0.0) == 0.0
    assert line_share(phase, 0.0, 0.0) == (0.0, 0.0)


@given(radii, rates, turns)
def test_the_offset_on_a_circle_is_the_integral_of_its_velocity(radius, rate, turns):
    _, t, p, v = circle(radius, rate, turns)
    omega = 2.0 * np.pi * rate
    # third derivatives of r(t) e^(i omega t): r''' + 3 r'' omega + 3 r' omega^2 + r omega^3, with r' <= 3/2 r_0 rate,
    # r'' <= 6 r_0 rate^2, r''' <= 12 r_0 rate^3
    curvature = radius * (12 * rate**3 + 18 * rate**2 * omega + 4.5 * rate * omega**2 + omega**3)
    # where the spiral ends, its growth 6 r_0 rate x (1 - x) stops falling
    assert_integral(t, p, v, curvature, kink=6.0 * radius * rate**2)


@given(radii, rates, turns)
def test_a_circle_starts_and_ends_at_rest_in_its_centre(radius, rate, turns):
    phase, t, _, v = circle(radius, rate, turns)
    assert circle_offset(phase, 0.0) == (0.0, 0.0, 0.0, 0.0)
    assert circle_offset(phase, t[-1]) == (0.0, 0.0, 0.0, 0.0)
    # it comes to rest there: next to both ends it is as slow as the spiral 6 r x of the share x of a turn
    for k in (1, -2):
        assert np.hypot(*v[k]) <= 6.0 * radius * rate * rate * (t[1] - t[0]) * 1.1


@given(radii, rates, turns)
def test_a_circle_keeps_its_radius_and_speed_in_the_full_turns(radius, rate, turns):
    _, t, p, v = circle(radius, rate, turns)
    full = (t >= 1.0 / rate) & (t <= t[-1] - 1.0 / rate)
    # rounding
    np.testing.assert_allclose(np.hypot(*p[full].T), radius, rtol=1e-12)
    np.testing.assert_allclose(np.hypot(*v[full].T), 2.0 * np.pi * rate * radius, rtol=1e-12)


@given(radii, rates, turns)
def test_a_circle_is_never_wider_nor_faster_than_its_full_turns(radius, rate, turns):
    _, _, p, v = circle(radius, rate, turns)
    # rounding
    assert np.hypot(*p.T).max() <= radius * (1.0 + 1e-12)
    assert np.hypot(*v.T).max() <= 2.0 * np.pi * rate * radius * (1.0 + 1e-12)


def test_a_circle_turns_counter_clockwise_and_takes_two_turns_more_to_spiral_in_and_out():
    phase, t, p, v = circle(0.005, 2.0, 3.0)
    assert t[-1] == circle_time(phase) == motion_time(phase, 0.0) == 2.5
    assert np.all((p[:, 0] * v[:, 1] - p[:, 1] * v[:, 0])[1:-1] > 0.0)


# in steps of 1e-6 m: shorter lines would only test underflow
points = st.tuples(*[st.integers(-30_000, 30_000)] * 3).map(lambda whole: np.array(whole) / 1e6)


@given(points, points, st.floats(0.0, 1.2))
def test_a_line_leads_straight_from_start_to_end(start, end, share):
    length = np.linalg.norm(end - start)
    phase = record(speed=0.04, ramp_in=0.1, ramp_out=0.1)
    p, v = np.empty(3), np.empty(3)
    motion(phase, start, end, length, share * motion_time(phase, length), p, v)
    if share >= 1.0:
        np.testing.assert_array_equal(p, end)
        np.testing.assert_array_equal(v, 0.0)
    # on the line, and towards its end: rounding
    assert np.linalg.norm(np.cross(p - start, end - start)) <= 1e-16
    assert np.linalg.norm(np.cross(v, end - start)) <= 1e-16
    assert v @ (end - start) >= 0.0


def test_a_circle_stays_at_its_height_about_its_start():
    start = np.array([0.01, -0.02, -0.1])
    phase = record(radius=0.005, rate=1.0, turns=2.0)
    p, v = np.empty(3), np.empty(3)
    motion(phase, start, start, 0.0, 1.25, p, v)
    # a quarter of a turn after the spiral: along +y of the start, moving towards -x; rounding
    np.testing.assert_allclose(p - start, [0.0, 0.005, 0.0], rtol=0, atol=1e-16)
    np.testing.assert_allclose(v, [-0.01 * np.pi, 0.0, 0.0], rtol=0, atol=1e-16)
