"""The FMU's equations at a time and a state: derivatives and event indicators."""

import numpy as np

from twin.compiled.function import carray, njit
from twin.cosim.native import doubles_at
from twin.drive.exchange.calls import at_time, on_doubles
from twin.drive.exchange.memory import (
    DERIVATIVES,
    INDICATOR_NOT_FINITE,
    INDICATORS,
    NOT_FINITE,
    SET_STATES,
    SET_TIME,
)


@njit(cache=True)
def brought(m, t, x):
    """Bring the FMU to time `t` and the states at `x`; 0, or a bad status."""
    status = at_time(m.set_time, (m.instance, t))
    if status > 1:
        return SET_TIME + status
    if m.states > 0:
        status = on_doubles(m.set_states, (m.instance, x, m.states))
        if status > 1:
            return SET_STATES + status
    return 0


@njit(cache=True)
def derivatives(m, t, x, dx):
    """Its derivatives at time `t` and the states at `x`, to `dx`; 0, or a bad status.

    `dx` has to have a guard behind it, see `memory.GUARD`.
    """
    status = brought(m, t, x)
    if status != 0:
        return status
    if m.states == 0:
        return 0
    status = on_doubles(m.derivatives_of, (m.instance, dx, m.states))
    if status > 1:
        return DERIVATIVES + status
    rates = carray(doubles_at(dx), m.states)
    for i in range(m.states):
        if not np.isfinite(rates[i]):
            m.element, m.asked = i, t
            return NOT_FINITE
    return 0


@njit(cache=True)
def indicators(m, z):
    """Its event indicators where it is, to `z`, which has to have a guard; 0, or a bad status."""
    status = on_doubles(m.indicators_of, (m.instance, z, m.indicators))
    if status > 1:
        return INDICATORS + status
    values = carray(doubles_at(z), m.indicators)
    for i in range(m.indicators):
        if not np.isfinite(values[i]):
            m.element = i
            return INDICATOR_NOT_FINITE
    return 0
