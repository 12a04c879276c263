"""How the reference of a phase moves: straight lines with smooth ends, circles that are spiralled into and out of."""

import math

import numpy as np

from twin.compiled.function import njit


@njit(cache=True)
def smooth(x):
    """The cubic 3 x^2 - 2 x^3 that goes from 0 to 1 with both slopes zero; 0 before, 1 after."""
    x = min(max(x, 0.0), 1.0)
    return x * x * (3.0 - 2.0 * x)


@njit(cache=True)
def _smooth_area(x):
    """Integral of `smooth` from 0 to x <= 1."""
    return x * x * x * (1.0 - 0.5 * x)


@njit(cache=True)
def line_speed(phase, length):
    """Speed (m/s) on a line of `length` (m): the wanted one, less where the line is too short for both ramps."""
    ramps = phase.ramp_in + phase.ramp_out
    return phase.speed if 2.0 * length >= phase.speed * ramps else 2.0 * length / ramps


@njit(cache=True)
def line_time(phase, length):
    """Time (s) the line takes."""
    if length == 0.0:
        return 0.0
    return length / line_speed(phase, length) + 0.5 * (phase.ramp_in + phase.ramp_out)


@njit(cache=True)
def line_share(phase, length, t):
    """(path, speed): how far (m) and how fast (m/s) along a line of `length` at `t` (s) from its start.

    The speed rises along `smooth` within ramp_in and falls likewise within ramp_out, so position, speed and
    acceleration are continuous, except that a ramp of 0 starts or ends at once.
    """
    total = line_time(phase, length)
    if t >= total or length == 0.0:
        return length, 0.0
    v = line_speed(phase, length)
    # a line that begins between two calls may do so a rounding after the second; without a ramp that would be t/0
    t = max(t, 0.0)
    if t < phase.ramp_in:
        x = t / phase.ramp_in
        return v * phase.ramp_in * _smooth_area(x), v * smooth(x)
    if t > total - phase.ramp_out:
        x = (total - t) / phase.ramp_out
        return length - v * phase.ramp_out * _smooth_area(x), v * smooth(x)
    return v * (t - 0.5 * phase.ramp_in), v


@njit(cache=True)
def circle_time(phase):
    """Time (s) of a circle with the turns that lead into and out of it."""
    return (phase.turns + 2.0) / phase.rate


@njit(cache=True)
def circle_offset(phase, t):
    """(x, y, v_x, v_y): offset (m) and velocity (m/s) from the centre at `t` (s); at rest there at both ends."""
    total = circle_time(phase)
    if t <= 0.0 or t >= total:
        return 0.0, 0.0, 0.0, 0.0
    x = min(t, total - t) * phase.rate
    r = phase.radius * smooth(x)
    growth = 6.0 * phase.radius * phase.rate * x * (1.0 - x) if x < 1.0 else 0.0
    if 2.0 * t > total:
        growth = -growth
    omega = 2.0 * np.pi * phase.rate
    c, s = math.cos(omega * t), math.sin(omega * t)
    return r * c, r * s, growth * c - r * omega * s, growth * s + r * omega * c


@njit(cache=True)
def motion_time(phase, length):
    """Time (s) the phase's motion takes on a line of `length` (m), or on its circle."""
    return circle_time(phase) if phase.radius > 0.0 else line_time(phase, length)


@njit(cache=True)
def motion(phase, start, end, length, t, p, v):
    """Reference position into `p` (3,) m and velocity into `v` (3,) m/s at `t` (s) after the phase began."""
    for i in range(3):
        p[i], v[i] = start[i], 0.0
    if phase.radius > 0.0:
        x, y, v[0], v[1] = circle_offset(phase, t)
        p[0], p[1] = start[0] + x, start[1] + y
    elif length > 0.0:
        path, speed = line_share(phase, length, t)
        for i in range(3):
            direction = (end[i] - start[i]) / length
            p[i] = end[i] if path == length else start[i] + path * direction
            v[i] = speed * direction
