"""The classical Runge-Kutta method of order 4, in steps of one length: for small equations that are not stiff.

It holds no tolerance. An event is looked for at the end of each step and found by halving the step before it.
"""

import numpy as np

from twin.compiled.function import carray, njit
from twin.cosim.native import doubles_at
from twin.drive.exchange.equations import brought, derivatives, indicators
from twin.drive.exchange.events import slack, step_completed

HALVINGS = 60
"""A step halved so often is shorter than two times that differ."""


@njit(cache=True)
def _moved(m, k, h):
    """The states at the start of the step and `h` times the rates at `k`, to `m.x`."""
    x, began = carray(doubles_at(m.x), m.states), carray(doubles_at(m.began), m.states)
    rates = carray(doubles_at(k), m.states)
    for i in range(m.states):
        x[i] = began[i] + h * rates[i]


@njit(cache=True)
def _stepped(m, t, h):
    """One step from time `t` and the states at `m.began`, whose rates are at `m.k_1`, to `m.x`; 0 or a bad status."""
    _moved(m, m.k_1, 0.5 * h)
    status = derivatives(m, t + 0.5 * h, m.x, m.k_2)
    if status != 0:
        return status
    _moved(m, m.k_2, 0.5 * h)
    status = derivatives(m, t + 0.5 * h, m.x, m.k_3)
    if status != 0:
        return status
    _moved(m, m.k_3, h)
    status = derivatives(m, t + h, m.x, m.k_4)
    if status != 0:
        return status
    x, began = carray(doubles_at(m.x), m.states), carray(doubles_at(m.began), m.states)
    k_1, k_2 = carray(doubles_at(m.k_1), m.states), carray(doubles_at(m.k_2), m.states)
    k_3, k_4 = carray(doubles_at(m.k_3), m.states), carray(doubles_at(m.k_4), m.states)
    for i in range(m.states):
        x[i] = began[i] + h / 6.0 * (k_1[i] + 2.0 * k_2[i] + 2.0 * k_3[i] + k_4[i])
    return brought(m, t + h, m.x)


@njit(cache=True)
def _crossed(m):
    """Whether an indicator has another sign than before; (that, 0 or a bad status)."""
    status = indicators(m, m.z)
    z, before = carray(doubles_at(m.z), m.indicators), carray(doubles_at(m.z_before), m.indicators)
    for i in range(m.indicators):
        if (z[i] > 0.0) != (before[i] > 0.0):
            return status == 0, status
    return False, status


@njit(cache=True)
def _located(m, t, h):
    """How long after `t` an indicator has changed its sign (s), which it has after `h`; (that, 0 or a bad status)."""
    low, high = 0.0, h
    for _ in range(HALVINGS):
        if high - low <= slack(t):
            break
        middle = 0.5 * (low + high)
        status = _stepped(m, t, middle)
        if status != 0:
            return high, status
        crossed, status = _crossed(m)
        if status != 0:
            return high, status
        if crossed:
            high = middle
        else:
            low = middle
    return high, _stepped(m, t, high)


@njit(cache=True)
def integrated(m, stop):
    """From `m.now` to `stop`, or to an event before it; (whether there is one, 0 or a bad status)."""
    span, start = stop - m.now, m.now
    steps = max(1, int(np.ceil(span / m.longest - 1e-9))) if m.longest > 0.0 else 1
    for n in range(steps):
        x, began = carray(doubles_at(m.x), m.states), carray(doubles_at(m.began), m.states)
        for i in range(m.states):
            began[i] = x[i]
        end = stop if n == steps - 1 else start + span * (n + 1) / steps
        h = end - m.now
        status = derivatives(m, m.now, m.began, m.k_1)
        if status == 0:
            status = _stepped(m, m.now, h)
        crossed = False
        if m.indicators > 0 and status == 0:
            crossed, status = _crossed(m)
            if crossed and status == 0:
                h, status = _located(m, m.now, h)
                end = min(m.now + h, end)
        if status != 0:
            return False, status
        m.now = end
        wanted, status = step_completed(m)
        if status != 0 or wanted or crossed:
            return wanted or crossed, status
    return False, 0
